"""A connection in memory: a dive waits at one end of it, a stand-in looks at the other, beat by beat."""

from __future__ import annotations

from dream.robots.bluerov2.threads import Threads


class MemoryStream:
    """Both ways of a connection, without a network.

    What it does: one end is a `dvl_a50.Stream`, which waits by `threads`. The other, `far`, has what a
    stand-in uses of a socket that does not block.
    Assumes: as with a socket, that each end is read by one thread.
    """

    def __init__(self, threads: Threads) -> None:
        """Connected, and nothing said yet."""
        self.far = Far(self)
        self.inbound, self.outbound = bytearray(), bytearray()
        """What this end, and the far one, have not read yet."""
        self.open = True
        self.news = threads.condition()

    def receive(self, timeout: float) -> bytes:
        """What has come since; empty where the far end hung up, a TimeoutError where nothing came."""
        with self.news:
            if not self.news.wait_for(lambda: bool(self.inbound) or not self.open, timeout):
                raise TimeoutError(f"nothing came for {timeout:g} s")
            data = bytes(self.inbound)
            self.inbound.clear()
        return data

    def send(self, data: bytes) -> None:
        """All of it, at once; a ConnectionError where the far end hung up."""
        with self.news:
            if not self.open:
                raise ConnectionResetError("the far end hung up")
            self.outbound += data

    def close(self) -> None:
        """Hang up; what was sent is still there to be read."""
        with self.news:
            self.open = False
            self.news.notify_all()


class Far:
    """The stand-in's end, of which nothing waits."""

    def __init__(self, pipe: MemoryStream) -> None:
        self._pipe = pipe

    def recv(self, most: int) -> bytes:
        """What has come, up to so many bytes; empty where the other end hung up, or a BlockingIOError."""
        pipe = self._pipe
        with pipe.news:
            data = bytes(pipe.outbound[:most])
            if not data and pipe.open:
                raise BlockingIOError
            del pipe.outbound[:most]
        return data

    def send(self, data: bytes | bytearray) -> int:
        """How many bytes were taken: all of them, or a BrokenPipeError where the other end hung up."""
        pipe = self._pipe
        with pipe.news:
            if not pipe.open:
                raise BrokenPipeError("the other end hung up")
            pipe.inbound += data
            pipe.news.notify_all()
        return len(data)

    def close(self) -> None:
        """Hang up."""
        self._pipe.close()
