"""Detection of adapters that echo our own frames.

``on`` and ``off`` are the user's settings. ``detect`` observes the first frame after opening whose reply cannot equal
it: if the frame is received before the reply, the adapter echoes; if the reply is received alone, it does not; silence
and fragments decide nothing. No frame is sent for that purpose. A later contradiction changes the result.

Some replies equal their request (FC06, FC08, and a C320 class 3 request whose checksum is its own). A wrong setting
can't forge such an acknowledgement:

* set ``on`` without an echo: the real reply is taken for the echo, nothing is left: NoReply;
* set ``off`` with an echo: a reply that equals its request is accepted only after this opening of the port has brought
  a reply that does not equal its request and had no echo before it. With an echoing adapter each read's reply has the
  request in front of it and is invalid;
* and an outcome is never confirmed by an acknowledgement alone: that takes a later read.
"""

from __future__ import annotations

from enum import Enum

from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.transaction import EchoFilter, Transaction

MAX_MISSING_ECHOES = 3  # frames in a row without their echo that make a detected echo uncertain again


class EchoState(Enum):
    """Whether the adapter echoes."""

    UNKNOWN = "unknown"
    ON = "on"
    OFF = "off"


ECHO_OFF = EchoState.OFF  # a member read from its class takes longer


class EchoDetector:
    """Detector for one port: whether it echoes, and whether a reply that equals its request may be accepted."""

    __slots__ = (
        "_initial_state",
        "_is_assumed",
        "_mirrored_frame",
        "_missing_echoes",
        "autodetect",
        "echo_count",
        "ruled_out",
        "state",
    )

    def __init__(self, setting: str) -> None:
        self.autodetect = setting == "detect"
        self._initial_state = EchoState.UNKNOWN if self.autodetect else EchoState(setting)
        self.echo_count = 0
        self.reset()

    def reset(self) -> None:
        """Reset the detection, because the adapter may be another one now."""
        self.state = self._initial_state
        self.ruled_out = False
        """Whether a reply unlike its request was received without an echo before it: ``state`` is OFF then."""
        self._is_assumed = False
        """Whether ``state`` is ON only because a reply that equals its request was received twice: the first of the two
        may be the echo, or the adapter has none and something on the bus sends each reply twice."""
        self._missing_echoes = 0
        self._mirrored_frame = b""
        """Last frame that was received again completely and not accepted as a reply."""

    def filter_for(self, prepared: PreparedRequest) -> EchoFilter | None:
        """Return the filter for the bytes that follow this frame, None where no echo is expected."""
        if self.state is ECHO_OFF:
            return None
        is_unknown = self.state is EchoState.UNKNOWN
        if is_unknown and prepared.is_mirrorable():
            return None
        tentative = is_unknown or (self._is_assumed and not prepared.is_mirrorable())
        return EchoFilter(prepared.data, tentative=tentative)

    def observe(self, transaction: Transaction) -> None:
        """Update the state from a finished transaction."""
        echo = transaction.echo
        if echo is not None and echo.was_received:
            self.echo_count += 1
            self._missing_echoes = 0
            self.state = EchoState.ON
            self._is_assumed = self._is_assumed and transaction.prepared.is_mirrorable()
        elif echo is not None and echo.tentative:
            alone = transaction.message is not None and transaction.final_error() is None
            self.state = EchoState.OFF if alone else EchoState.UNKNOWN
        elif echo is not None:
            self._missing_echoes += 1
            if self._missing_echoes >= MAX_MISSING_ECHOES:
                self.reset()
        elif self.autodetect and (_echoed_before_tx_end(transaction) or _echoed_as_reply(transaction)):
            self.state, self.ruled_out = EchoState.ON, False
            self._is_assumed = transaction.prepared.is_mirrorable() and not _echoed_before_tx_end(transaction)

    def accepts(self, transaction: Transaction) -> bool:
        """Return whether this complete reply is not our own frame; a reply unlike its request rules the echo out."""
        if transaction.echo is not None and transaction.echo.was_received:
            return True
        if transaction.buffer != transaction.prepared.data:
            if not transaction.bytes_before_tx_end:
                self.state, self.ruled_out, self._mirrored_frame = EchoState.OFF, True, b""
            return True
        self._mirrored_frame = transaction.prepared.data if self.autodetect and not self.ruled_out else b""
        return self.ruled_out

    def record_repeat(self, data: bytes) -> None:
        """Check an unsolicited frame: after a repeat of the last mirrored frame, the first one counts as our echo."""
        if data and data == self._mirrored_frame:
            self.state, self._mirrored_frame, self._is_assumed = EchoState.ON, b"", True


def _echoed_before_tx_end(transaction: Transaction) -> bool:
    """Return whether our frame was received in part before our own last bit, when no station can have replied."""
    early = transaction.bytes_before_tx_end
    return bool(early) and (early + transaction.buffer).startswith(transaction.prepared.data)


def _echoed_as_reply(transaction: Transaction) -> bool:
    """Return whether our frame stands in place of a reply, or twice where its reply equals it."""
    data, received = transaction.prepared.data, transaction.buffer
    is_echoed = received.startswith(data + data) if transaction.prepared.is_mirrorable() else data in received
    return transaction.error is not None and is_echoed
