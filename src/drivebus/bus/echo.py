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

from drivebus.bus.prepared_request import PreparedRequest
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Incomplete

if TYPE_CHECKING:
    from drivebus.bus.transaction import Transaction

MAX_MISSING_ECHOES = 3
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
    def is_complete(self) -> bool:
        return self.matched == len(self.sent)

    def strip(self, data: bytes) -> bytes:
        """The bytes that are no echo."""
        if self.is_complete or self.collided:
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


class EchoDetector:
    """Knows for one port whether it echoes, and whether a mirrored reply may be believed."""

    __slots__ = ("_mirrored_frame", "_missing_echoes", "autodetect", "echo_count", "ruled_out", "state")

    def __init__(self, setting: str) -> None:
        self.autodetect = setting == "detect"
        self.state = EchoState.UNKNOWN if self.autodetect else EchoState(setting)
        self.ruled_out = False
        """A reply unlike its request came with no echo before it: there is none on this port."""
        self.echo_count = 0
        self._missing_echoes = 0
        self._mirrored_frame = b""
        """The last frame that came back whole and was not believed to be a reply."""

    def reset(self) -> None:
        """Another adapter may be in its place now: everything has to be found out again."""
        self.ruled_out = False
        self._missing_echoes, self._mirrored_frame = 0, b""
        if self.autodetect:
            self.state = EchoState.UNKNOWN

    def filter_for(self, job: PreparedRequest) -> EchoFilter | None:
        """What to listen to this frame with."""
        if self.state is EchoState.OFF or (self.state is EchoState.UNKNOWN and is_mirrorable(job)):
            return None
        return EchoFilter(job.data, tentative=self.state is EchoState.UNKNOWN)

    def observe(self, transaction: Transaction) -> None:
        """Learn from a finished transaction."""
        used = transaction.echo
        if used is not None and used.is_complete and used.sent:
            self.echo_count += 1
            self._missing_echoes = 0
            self.state = EchoState.ON
        elif used is not None and used.tentative:
            alone = not used.matched and transaction.message is not None and transaction.final_error() is None
            self.state = EchoState.OFF if alone else EchoState.UNKNOWN
        elif used is not None:
            self._missing_echoes += 1
            if self.autodetect and self._missing_echoes >= MAX_MISSING_ECHOES:
                self.reset()
        elif self.autodetect and (_echoed_before_tx_end(transaction) or _echoed_as_reply(transaction)):
            self.state, self.ruled_out = EchoState.ON, False

    def accepts(self, transaction: Transaction) -> bool:
        """May this whole reply be the station's, or could it be our own frame? Learns from replies that can't."""
        used = transaction.echo
        if used is not None and used.is_complete and used.sent:
            return True
        if transaction.buffer != transaction.prepared.data:
            self.ruled_out = self.ruled_out or not transaction.bytes_before_tx_end
            return True
        self._mirrored_frame = transaction.prepared.data if self.autodetect and not self.ruled_out else b""
        return self.ruled_out

    def note_repeat(self, data: bytes) -> None:
        """A frame that nobody asked for: the one that was taken for a reply was our own, and this is its reply."""
        if data and data == self._mirrored_frame:
            self.state, self._mirrored_frame = EchoState.ON, b""


def _echoed_before_tx_end(transaction: Transaction) -> bool:
    """Our frame was heard, and not all of it after our own last bit, when nobody can have answered yet."""
    return bool(transaction.bytes_before_tx_end) and (transaction.bytes_before_tx_end + transaction.buffer).startswith(
        transaction.prepared.data
    )


def _echoed_as_reply(transaction: Transaction) -> bool:
    """It was heard where a reply should stand and is none, or twice: once as our frame, once as its mirrored reply."""
    data, heard = transaction.prepared.data, bytes(transaction.buffer)
    found = heard.startswith(data + data) if is_mirrorable(transaction.prepared) else data in heard
    return transaction.error is not None and found


def is_mirrorable(job: PreparedRequest) -> bool:
    """Could the request's own bytes pass for the beginning of its reply?"""
    try:
        return not isinstance(job.codec.decode_reply(job.request, job.data), Incomplete)
    except ProtocolError:
        return False
