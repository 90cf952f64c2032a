"""Bytes to the vehicle and back: UDP and TCP."""

from __future__ import annotations

import errno
import math
import socket
import time
from collections import Counter
from typing import Protocol

QUIET = 0.25
"""Seconds that a receiver waits before it looks whether it is to end."""


class Pipe(Protocol):
    """Carries bytes to the vehicle and back."""

    def send(self, data: bytes) -> bool:
        """Send one packet; False where there is nobody to send to yet. Raises OSError."""

    def receive(self) -> bytes:
        """What came, after a quarter of a second at most; empty when nothing did. Raises OSError."""

    def answered(self, lost: float) -> None:
        """The vehicle was heard in what came last: send there, if whom it sent to is `lost` seconds gone."""

    def close(self) -> None:
        """Give the port back; a `receive` under way ends soon."""


def taken(error: OSError, port: int) -> OSError:
    """What is to be said where a port of this computer cannot be had."""
    if error.errno != errno.EADDRINUSE:
        return error
    return OSError(
        f"expected port {port} of this computer to be free, got one that another program has. "
        "Close QGroundControl, Cockpit or another dive"
    )


class Udp:
    """Datagrams: to whom it was told, or to whom it was first spoken to by.

    While that one is there nobody else is heard: every vehicle has system id 1 as it is sold, and two of them
    at one port must not be taken for one. What is dropped is counted in `refused`, by reason.
    """

    def __init__(self, host: str, port: int, *, listen: bool, refused: Counter[str] | None = None) -> None:
        self.refused: Counter[str] = Counter() if refused is None else refused
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(QUIET)
        try:
            self._peer: tuple[str, int] | None = None
            if listen:
                self._socket.bind((host, port))
            else:
                self._peer = socket.gethostbyname(host), port
        except OSError as error:
            self._socket.close()
            raise taken(error, port) from error
        self._fixed = not listen
        self._from: tuple[str, int] | None = None
        self._heard = self._there_until = -math.inf

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> bool:
        """As `Pipe` says."""
        if self._peer is None:
            return False
        self._socket.sendto(data, self._peer)
        return True

    def receive(self) -> bytes:
        """As `Pipe` says."""
        try:
            data, self._from = self._socket.recvfrom(65535)
        except TimeoutError:
            return b""
        if self._from != self._peer and time.monotonic() <= self._there_until:
            self.refused["from another address"] += 1
            return b""
        return data

    def answered(self, lost: float) -> None:
        """As `Pipe` says."""
        now = time.monotonic()
        if not self._fixed and self._from != self._peer and now - self._heard > lost:
            self._peer = self._from
        if self._from == self._peer:
            self._heard, self._there_until = now, now + lost

    def close(self) -> None:
        """As `Pipe` says."""
        self._socket.close()


class Tcp:
    """A stream, opened again when it breaks."""

    def __init__(self, host: str, port: int) -> None:
        self._address = host, port
        self._socket: socket.socket | None = None

    def send(self, data: bytes) -> bool:
        """As `Pipe` says."""
        stream = self._socket
        if stream is None:
            return False
        stream.sendall(data)
        return True

    def receive(self) -> bytes:
        """As `Pipe` says."""
        if self._socket is None:
            self._socket = socket.create_connection(self._address, 2.0)
            self._socket.settimeout(QUIET)
        try:
            data = self._socket.recv(65535)
        except TimeoutError:
            return b""
        except OSError:
            self.close()
            raise
        if not data:
            self.close()
            raise ConnectionError(f"{self._address[0]}:{self._address[1]} hung up")
        return data

    def answered(self, lost: float) -> None:
        """As `Pipe` says."""

    def close(self) -> None:
        """As `Pipe` says."""
        stream, self._socket = self._socket, None
        if stream is not None:
            stream.close()


def open_pipe(address: str, refused: Counter[str] | None = None) -> Pipe:
    """udpin:HOST:PORT (or HOST:PORT) listens; udpout:HOST:PORT and tcp:HOST:PORT go there.

    What comes and is dropped is counted in `refused`, by reason.

    Raises:
        ValueError: Not an address.
        OSError: The port is taken.
    """
    kind, _, rest = address.partition(":")
    if kind not in ("udpin", "udpout", "tcp"):
        kind, rest = "udpin", address
    host, _, port = rest.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise ValueError(
            f"address: expected udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT, got {address!r}"
        )
    if kind == "tcp":
        return Tcp(host, int(port))
    return Udp(host, int(port), listen=kind == "udpin", refused=refused)
