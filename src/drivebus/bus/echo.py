"""Our own frame coming back from a two-wire adapter (F03): found, compared byte by byte, removed by position.

How it is known whether the adapter echoes. ``on`` and ``off`` are the user's word. ``detect`` listens to the first
frame after opening whose reply cannot look like itself: if the frame comes back first, the adapter echoes, and if its
reply comes alone, it does not; silence and debris tell nothing. No frame is sent for that purpose, so nobody is
disturbed. A later frame that proves the finding wrong changes it: also one that is heard once more after it had passed
for its own mirrored reply, else a line on which only fences are asked any more would never find out.

What keeps a wrong setting from forging an acknowledgement (G19), where a reply equals its request (FC06, FC08, and
the sum of a C320 class-3 request, T21):

* set ``on`` without an echo: the real answer is taken for the echo, nothing is left: NoReply;
* set ``off`` with an echo: a reply that mirrors its request is believed only after this opening of the port has
  brought a reply that does *not* mirror its request and had no echo before it. An echoing adapter can't bring one:
  each read's answer has the request in front of it and is void. On a paced port bytes before our last stop bit are
  dropped anyway, and a reply after such bytes proves nothing;
* and an Answer is never called confirmed: that takes a later read with another shape (ruling 1).
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from drivebus.bus.job import Job
from drivebus.errors import ProtocolError
from drivebus.message import Incomplete

if TYPE_CHECKING:
    from drivebus.bus.transaction import Transaction

DOUBTS = 3
"""So many frames in a row without their echo make a detected echo uncertain again."""


class EchoFilter:
    """Removes the echo of one frame. ``tentative``: a mismatch only says that there is no echo."""

    __slots__ = ("collided", "matched", "sent", "tentative")

    def __init__(self, sent: bytes, tentative: bool) -> None:
        self.sent = sent
        self.tentative = tentative
        self.matched = 0
        self.collided = False

    @property
    def whole(self) -> bool:
        return self.matched == len(self.sent)

    def strip(self, data: bytes) -> bytes:
        """The bytes that are no echo."""
        if self.whole or self.collided:
            return data
        expected = self.sent[self.matched : self.matched + len(data)]
        if data.startswith(expected):
            self.matched += len(expected)
            return data[len(expected) :]
        if not self.tentative:
            self.matched += next(i for i, (a, b) in enumerate(zip(data, expected, strict=False)) if a != b)
            self.collided = True
            return data
        held, self.sent = self.sent[: self.matched], b""
        self.matched = 0
        return held + data


class EchoState(Enum):
    """What is known of the adapter."""

    UNKNOWN = "unknown"
    ON = "on"
    OFF = "off"


class EchoKeeper:
    """Knows for one port whether it echoes, and whether a mirrored reply may be believed."""

    __slots__ = ("_mirrored", "_missing", "count", "detect", "proved", "state")

    def __init__(self, setting: str) -> None:
        self.detect = setting == "detect"
        self.state = EchoState.UNKNOWN if self.detect else EchoState(setting)
        self.proved = False
        """A reply unlike its request came with no echo before it: there is none on this port."""
        self.count = 0
        self._missing = 0
        self._mirrored = b""
        """The last frame that came back whole and was not believed to be a reply."""

    def opened(self) -> None:
        """Another adapter may be in its place now: everything has to be found out again."""
        self.proved = False
        self._missing, self._mirrored = 0, b""
        if self.detect:
            self.state = EchoState.UNKNOWN

    def filter_for(self, job: Job) -> EchoFilter | None:
        """What to listen to this frame with."""
        if self.state is EchoState.OFF or (self.state is EchoState.UNKNOWN and mirrorable(job)):
            return None
        return EchoFilter(job.data, tentative=self.state is EchoState.UNKNOWN)

    def concluded(self, flight: Transaction) -> None:
        """Learn from a finished transaction."""
        used = flight.echo
        if used is not None and used.whole and used.sent:
            self.count += 1
            self._missing = 0
            self.state = EchoState.ON
        elif used is not None and used.tentative:
            alone = not used.matched and flight.message is not None and flight.outcome() is None
            self.state = EchoState.OFF if alone else EchoState.UNKNOWN
        elif used is not None:
            self._missing += 1
            if self.detect and self._missing >= DOUBTS:
                self.opened()
        elif self.detect and (_came_back_early(flight) or _came_back_instead(flight)):
            self.state, self.proved = EchoState.ON, False

    def believes(self, flight: Transaction) -> bool:
        """May this whole reply be the station's, or could it be our own frame? Learns from replies that can't."""
        used = flight.echo
        if used is not None and used.whole and used.sent:
            return True
        if flight.buffer != flight.job.data:
            self.proved = self.proved or not flight.early
            return True
        self._mirrored = flight.job.data if self.detect and not self.proved else b""
        return self.proved

    def came_again(self, data: bytes) -> None:
        """A frame that nobody asked for: the one that was taken for a reply was our own, and this is its reply."""
        if data and data == self._mirrored:
            self.state, self._mirrored = EchoState.ON, b""


def _came_back_early(flight: Transaction) -> bool:
    """Our frame was heard, and not all of it after our own last bit, when nobody can have answered yet."""
    return bool(flight.early) and (flight.early + flight.buffer).startswith(flight.job.data)


def _came_back_instead(flight: Transaction) -> bool:
    """It was heard where a reply should stand and is none, or twice: once as our frame, once as its mirrored reply."""
    data, heard = flight.job.data, bytes(flight.buffer)
    found = heard.startswith(data + data) if mirrorable(flight.job) else data in heard
    return flight.error is not None and found


def mirrorable(job: Job) -> bool:
    """Could the request's own bytes pass for the beginning of its reply?"""
    try:
        return not isinstance(job.codec.decode_reply(job.request, job.data), Incomplete)
    except ProtocolError:
        return False
