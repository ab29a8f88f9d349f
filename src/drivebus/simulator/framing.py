"""Framing of requests by the stations of one family: from characters and silence to one frame.

A frame ends by its length (C320, DZB100, Modbus ASCII) or by silence (RTU); a parity or framing error corrupts it. A
frame after too little silence is counted, and ignored where the manual says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec, Complete
from drivebus.serial_settings import SerialSettings

SILENCE_TOLERANCE_S = 1e-6  # a silence in the event loop's time may be rounded to a little less
DECODED_FRAMES = 1024  # distinct frames kept decoded: masters repeat their polls


@dataclass(frozen=True, slots=True, kw_only=True)
class FramingRule:
    """Framing of one family."""

    gap_characters: float
    """Silence before a frame, in characters."""
    gap_floor_s: float = 0.0
    requires_gap: bool = False
    """Whether a frame without the silence before it is ignored (C320 2.2.4)."""
    ends_by_silence: bool = False
    start_bytes: bytes = b""
    """First bytes of a frame; empty for any."""
    restarts_on_start_byte: bool = False
    """Whether a start byte always begins a new frame (Modbus ASCII ':')."""

    def gap_s(self, settings: SerialSettings) -> float:
        return max(settings.seconds(self.gap_characters), self.gap_floor_s)


MODBUS_RTU_FRAMING = FramingRule(gap_characters=3.5, ends_by_silence=True)
MODBUS_ASCII_FRAMING = FramingRule(gap_characters=0.0, start_bytes=b":", restarts_on_start_byte=True)


@dataclass(slots=True, kw_only=True)
class ReceivedFrame:
    """Received frame: its request, or the error of its decoding. Not frozen, which takes thrice as long to make."""

    codec: Codec
    message: Any
    error: ProtocolError | None
    frame: bytes
    address: int | None
    """Address of the request; None where it can't be decoded."""
    short_gap: bool
    """Whether the silence before it was too short."""
    silence_s: float
    """Silence before its first byte in seconds."""


class FrameReceiver:
    """Frame receiver for one family, or one encoding of it, on one wire."""

    def __init__(
        self,
        codecs: tuple[Codec, ...],
        rule: FramingRule,
        settings: SerialSettings,
        tolerance_s: float = SILENCE_TOLERANCE_S,
    ) -> None:
        self.codecs = codecs
        self.rule = rule
        self.gap_s = rule.gap_s(settings)
        self.tolerance_s = tolerance_s
        """Tolerance of measured silences in seconds (jitter of the operating system)."""
        self.decision_delay_s = self.gap_s if rule.ends_by_silence else 0.0
        """Delay from the last byte to the decision on a frame, in seconds."""
        self._start_characters = tuple(bytes((byte,)) for byte in rule.start_bytes)
        self._buffer = bytearray()
        self._corrupted = self._ignoring = self._short_gap = False
        self._silence_s = 0.0

    def feed(self, data: bytes, line_errors: int, silence_s: float) -> list[ReceivedFrame]:
        """Feed characters after ``silence_s`` of silence; return the frames that are complete by length."""
        if silence_s >= self.gap_s - self.tolerance_s:
            self._begin_frame(silence_s, short=False)
        elif not self._buffer:
            self._begin_frame(silence_s, short=True)
        if self.rule.restarts_on_start_byte and (at := data.rfind(self.rule.start_bytes)) >= 0:
            self._begin_frame(silence_s, short=False)
            data = data[at:]
        self._corrupted = self._corrupted or line_errors > 0
        if self._ignoring or (not self._buffer and self.rule.start_bytes and data[:1] not in self._start_characters):
            self._ignoring = True
            return []
        self._buffer += data
        return [] if self.rule.ends_by_silence else self._take_complete_frame()

    def on_silence(self) -> list[ReceivedFrame]:
        """Return the frame that silence has ended, if its first to last byte are one request."""
        frame = bytes(self._buffer)
        self._buffer.clear()
        if not frame or self._corrupted:
            return []
        received = self._decode(frame)
        return [received] if received is not None and len(received.frame) == len(frame) else []

    def _begin_frame(self, silence_s: float, *, short: bool) -> None:
        self._buffer.clear()
        self._corrupted = False
        self._short_gap = short
        self._ignoring = short and self.rule.requires_gap
        self._silence_s = silence_s

    def _take_complete_frame(self) -> list[ReceivedFrame]:
        """Return at most one frame; what follows it without silence is ignored."""
        frame = bytes(self._buffer)
        received = self._decode(frame)
        if received is None:
            return []
        self._buffer.clear()
        self._ignoring = len(frame) > len(received.frame)
        return [] if self._corrupted else [received]

    def _decode(self, frame: bytes) -> ReceivedFrame | None:
        """Decode the frame at offset 0; None while it is incomplete."""
        codec = self._codec_for(frame)
        try:
            decoded = _decode_request(codec, frame)
        except ProtocolError as error:
            size = error.size or len(frame)
            return ReceivedFrame(
                codec=codec,
                message=None,
                error=error,
                frame=frame[:size],
                address=_error_address(error),
                short_gap=self._short_gap,
                silence_s=self._silence_s,
            )
        if decoded is None:
            return None
        message, size, address = decoded
        return ReceivedFrame(
            codec=codec,
            message=message,
            error=None,
            frame=frame[:size],
            address=address,
            short_gap=self._short_gap,
            silence_s=self._silence_s,
        )

    def _codec_for(self, frame: bytes) -> Codec:
        """Return the codec: a C320 frame names its encoding by the first byte, other families have one codec."""
        if len(self.codecs) == 1:
            return self.codecs[0]
        return self.codecs[self.rule.start_bytes.index(frame[:1])]


@lru_cache(DECODED_FRAMES)
def _decode_request(codec: Codec, frame: bytes) -> tuple[Any, int, int | None] | None:
    """Return message, size and address of the request at offset 0; None while it is incomplete."""
    result = codec.decode_request(frame)
    if not isinstance(result, Complete):
        return None
    request = getattr(result.message, "request", result.message)
    address = codec.broadcast_address if getattr(request, "broadcast", False) else codec.address_of(request)
    return result.message, result.size, address


def _error_address(error: ProtocolError) -> int | None:
    address = error.params.get("address")
    return address if isinstance(address, int) else None
