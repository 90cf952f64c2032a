"""Connections: how long one may take to ask, and who has to go where there are too many.

Anybody may connect, and say nothing, or a letter a minute. Such a connection holds a place at the door for
a while at most, and is the first to go; places in the house are for those who passed the door.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_STRANGERS = 128
"""Connections at the door; where one more comes, the one that has been there for longest goes. With those
inside they are fewer than the 256 files that some systems let a program open."""
MOST_AT_ONCE = 64
"""Taken from the system before those that are there are heard: fewer than at the door, so that one that asks
at once is heard before it has to go."""
ASK_S = 10.0
"""Seconds in which a request has to be there whole, from its connection or from the end of the one before."""
TAKE_S = 10.0
"""Seconds in which some of what waits to be sent has to be taken."""
MOST_HEAD = 16 << 10
"""Bytes of the head of a request."""


class House:
    """The connections of a server: strangers, and those of which a request passed the door."""

    def __init__(self, places: int) -> None:
        """With so many places for those who passed."""
        self._places = places
        self._strangers: dict[Guest, None] = {}
        self._inside: dict[Guest, None] = {}
        self._of: dict[tuple[str, int] | None, Guest] = {}

    def enter(self, guest: Guest) -> None:
        """One more is at the door."""
        self._strangers[guest] = None
        self._of[guest.client] = guest
        if len(self._strangers) > MOST_STRANGERS:
            next(iter(self._strangers)).transport.abort()

    def leave(self, guest: Guest) -> None:
        """One is gone."""
        self._strangers.pop(guest, None)
        self._inside.pop(guest, None)
        if self._of.get(guest.client) is guest:
            del self._of[guest.client]

    def admit(self, client: Any) -> bool:
        """Whether there is a place for a connection whose request passed the door.

        Args:
            client: Address and port that it comes from, as ASGI has them.
        """
        guest = self._of.get(None if client is None else tuple(client))
        if guest is None or guest in self._inside:
            return True
        if len(self._inside) >= self._places:
            return False
        self._strangers.pop(guest, None)
        self._inside[guest] = None
        return True


class Guest(H11Protocol):
    """A connection that has to ask and to take in time."""

    def __init__(self, house: House, **given: Any) -> None:
        """A guest of that house; the rest is uvicorn's."""
        super().__init__(**given)
        self._house = house
        self._asking: asyncio.TimerHandle | None = None
        self._taking: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """One came."""
        super().connection_made(transport)
        self._house.enter(self)
        self._wait_for_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """It went."""
        self._house.leave(self)
        for timer in (self._asking, self._taking):
            if timer is not None:
                timer.cancel()
        self._asking = self._taking = None
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """It said something: enough for a request, or not yet."""
        super().data_received(data)
        self._wait_for_request()

    def on_response_complete(self) -> None:
        """It was answered, and may ask again."""
        super().on_response_complete()
        self._wait_for_request()

    def pause_writing(self) -> None:
        """It does not take what it is sent."""
        super().pause_writing()
        self._taking = self.loop.call_later(TAKE_S, self.transport.abort)

    def resume_writing(self) -> None:
        """It does."""
        super().resume_writing()
        if self._taking is not None:
            self._taking.cancel()
            self._taking = None

    def _wait_for_request(self) -> None:
        """Run the clock until a request is there whole; what comes of it meanwhile wins no time.

        So it runs of a connection that is closed, too, until all that was sent is taken.
        """
        whole = self.conn.their_state not in (h11.IDLE, h11.SEND_BODY) and not self.transport.is_closing()
        if whole and self._asking is not None:
            self._asking.cancel()
            self._asking = None
        elif not whole and self._asking is None:
            self._asking = self.loop.call_later(ASK_S, self.transport.abort)


def guests_of(house: House) -> Callable[..., asyncio.Protocol]:
    """What makes a connection of each that comes, for uvicorn."""

    def made(**given: Any) -> Guest:
        return Guest(house, **given)

    return made
