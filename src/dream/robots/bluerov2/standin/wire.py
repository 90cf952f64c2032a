"""Datagrams to and from the ground station, and what can befall them on the way."""

from __future__ import annotations

import heapq
import math
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dream.robots.bluerov2.threads import Threads
from dream.robots.bluerov2.wire import QUIET

Address = tuple[str, int]
Change = Callable[[bytes], "bytes | None"]

SURFACE: Address = ("surface", 14550)
"""Where the surface computer is at the other end of a `Cable`."""
MOST_BYTES = 2048
"""Of a datagram that is read."""
MOST_AT_ONCE = 256
"""Datagrams that are read in one beat."""
MOST_WAITING = 10_000
"""Datagrams that are on their way; more are lost."""


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """What befalls datagrams, each on its own, both ways."""

    loss: float = 0.0
    """Share that is lost."""
    delay: float = 0.0
    """Seconds that all take."""
    jitter: float = 0.0
    """Greatest seconds on top, evenly: where it is long against the time between two, they swap."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.loss <= 1.0:
            raise ValueError(f"faults.loss: expected a share, got {self.loss}")
        if not (0.0 <= self.delay < math.inf and 0.0 <= self.jitter < math.inf):
            raise ValueError(f"faults: expected seconds of 0 or more, got {self.delay} and {self.jitter}")


class Datagrams(Protocol):
    """What is used of a socket that does not block."""

    def recvfrom(self, most: int, /) -> tuple[bytes, Address]: ...  # noqa: D102
    def sendto(self, data: bytes, to: Address, /) -> int: ...  # noqa: D102
    def getsockname(self) -> Address: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


class Cable:
    """A tether in memory, between the vehicle and a surface computer that waits by a clock of its own.

    What it does: to the link of a dive it is a `wire.Pipe`, to the stand-in the socket of a `Wire`. Datagrams
    come in the order in which they were sent.

    Faults: `up` and `down` say what becomes of a datagram on its way; None where it is lost.
    """

    def __init__(self, threads: Threads) -> None:
        """Nothing is on its way."""
        self.up: Change = _as_it_is
        self.down: Change = _as_it_is
        self._news = threads.condition()
        self._up: deque[bytes] = deque()
        self._down: deque[bytes] = deque()

    # The surface computer's end

    def send(self, data: bytes) -> bool:
        """As `wire.Pipe` says."""
        changed = self.down(data)
        if changed is not None:
            self._down.append(changed)
        return True

    def receive(self) -> bytes:
        """As `wire.Pipe` says."""
        with self._news:
            self._news.wait_for(lambda: bool(self._up), QUIET)
            return self._up.popleft() if self._up else b""

    def answered(self, lost: float) -> None:
        """As `wire.Pipe` says."""

    # The vehicle's end

    def recvfrom(self, most: int, /) -> tuple[bytes, Address]:
        """What came, and a BlockingIOError where nothing did."""
        if not self._down:
            raise BlockingIOError
        return self._down.popleft()[:most], SURFACE

    def sendto(self, data: bytes, to: Address, /) -> int:
        """To whomever: there is but one."""
        changed = self.up(data)
        with self._news:
            if changed is not None:
                self._up.append(changed)
            self._news.notify_all()
        return len(data)

    def getsockname(self) -> Address:
        """The vehicle's own."""
        return "vehicle", 0

    def close(self) -> None:
        """Either end."""


class Wire:
    """A UDP socket of the vehicle's own, as BlueOS's UDP client endpoint has one.

    What it does: what the vehicle tells everybody goes to the ground station's address, an answer to where
    the question came from. `faults` may be replaced at any time; with a ground station of None only those who
    asked are told anything.
    """

    def __init__(
        self,
        ground: Address | None,
        *,
        host: str = "127.0.0.1",
        seed: int = 1,
        datagrams: Datagrams | None = None,
    ) -> None:
        """Bind to a free port, unless there is something else that carries `datagrams`."""
        self.ground = ground
        self.faults = LinkFaults()
        self._rng = np.random.default_rng(seed)
        self._socket = datagrams or _bound(host)
        self.address: Address = self._socket.getsockname()
        self._count = 0
        self._out: list[tuple[float, int, bytes, Address]] = []
        self._in: list[tuple[float, int, bytes, Address]] = []

    def send(self, data: bytes, to: Address | None, now: float) -> None:
        """Send to an address, or to the ground station."""
        where = to or self.ground
        if where is not None:
            self._pass(self._out, data, where, now)

    def receive(self, now: float) -> list[tuple[bytes, Address]]:
        """What has arrived by now; and send what is due."""
        for _ in range(MOST_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(MOST_BYTES)
            except OSError:
                # Nothing is there; or what was sent before met nobody, which says nothing of the next.
                break
            self._pass(self._in, data, sender, now)
        self.flush(now)
        arrived = []
        while self._in and self._in[0][0] <= now:
            _, _, data, sender = heapq.heappop(self._in)
            arrived.append((data, sender))
        return arrived

    def flush(self, now: float) -> None:
        """Send what is due."""
        while self._out and self._out[0][0] <= now:
            _, _, data, to = heapq.heappop(self._out)
            try:
                self._socket.sendto(data, to)
            except OSError:
                # Nobody listens, or the queue is full: so are datagrams lost.
                continue

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def _pass(
        self, queue: list[tuple[float, int, bytes, Address]], data: bytes, at: Address, now: float
    ) -> None:
        faults = self.faults
        if (faults.loss > 0.0 and self._rng.random() < faults.loss) or len(queue) >= MOST_WAITING:
            return
        late = faults.delay
        if faults.jitter > 0.0:
            late += faults.jitter * float(self._rng.random())
        self._count += 1
        heapq.heappush(queue, (now + late, self._count, data, at))


def _as_it_is(data: bytes) -> bytes:
    return data


def _bound(host: str) -> Datagrams:
    """A socket at a free port."""
    free = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    free.bind((host, 0))
    free.setblocking(False)
    return free
