"""How stations of one family hear: from characters and silence to one frame. Pure; shared by the stations of a bench.

Two habits: a frame ends with its length (C320, DZB100, Modbus ASCII) or with silence (RTU). Bytes with a parity or
framing error spoil the frame that they are in. A frame that begins too soon after other traffic is counted, and where
the manual says so, not recognised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.line import LineSettings
from drivebus.message import Codec, Complete


@dataclass(frozen=True, slots=True)
class EarRule:
    """A family's framing."""

    gap_characters: float
    """Silence that begins a frame afresh."""
    gap_floor_s: float = 0.0
    needs_gap: bool = False
    """Without the silence before it a frame is not recognised (C320 2.2.4)."""
    ends_by_silence: bool = False
    starts: bytes = b""
    """First bytes that can begin a frame; empty = any."""
    resyncs: bool = False
    """A start byte always begins a new frame (Modbus ASCII ':')."""

    def gap_s(self, line: LineSettings) -> float:
        return max(line.seconds(self.gap_characters), self.gap_floor_s)


@dataclass(frozen=True, slots=True)
class Heard:
    """A whole frame: its request, or the error that it was refused with."""

    codec: Codec
    message: Any
    error: ProtocolError | None
    frame: bytes
    address: int | None
    """Whom it speaks to, None where nobody can tell."""
    short_gap: bool
    """It began after less silence than the rule asks for."""
    quiet_s: float
    """Silence before its first byte."""


class Ear:
    """The receiver of one family (or one encoding of it) on one wire."""

    def __init__(self, codecs: tuple[Codec, ...], rule: EarRule, line: LineSettings, tolerance_s: float = 1e-6) -> None:
        self.codecs = codecs
        self.rule = rule
        self.gap_s = rule.gap_s(line)
        self.tolerance_s = tolerance_s
        """By how much a measured silence may be short (the operating system's jitter on real ports)."""
        self.wait_s = self.gap_s if rule.ends_by_silence else 0.0
        """How long after the last byte a frame is decided on."""
        self._buffer = bytearray()
        self._spoilt = self._deaf = self._short = False
        self._quiet_s = 0.0

    def hear(self, data: bytes, marks: int, quiet_s: float) -> list[Heard]:
        """Characters without a pause, after ``quiet_s`` of silence; the frames that they complete by their length."""
        if quiet_s >= self.gap_s - self.tolerance_s:
            self._begin(quiet_s, short=False)
        elif not self._buffer:
            self._begin(quiet_s, short=True)
        if self.rule.resyncs and (at := data.rfind(self.rule.starts)) >= 0:
            self._begin(quiet_s, short=False)
            data = data[at:]
        self._spoilt = self._spoilt or marks > 0
        if self._deaf or (not self._buffer and self.rule.starts and data[:1] not in self._starts()):
            self._deaf = True
            return []
        self._buffer += data
        return [] if self.rule.ends_by_silence else self._by_length()

    def silence(self) -> list[Heard]:
        """The silence that ends a frame has passed: the frame, if it is one from its first byte to its last."""
        frame, self._buffer = bytes(self._buffer), bytearray()
        if not frame or self._spoilt:
            return []
        heard = self._decoded(frame)
        return [heard] if heard is not None and len(heard.frame) == len(frame) else []

    def _starts(self) -> tuple[bytes, ...]:
        return tuple(bytes((byte,)) for byte in self.rule.starts)

    def _begin(self, quiet_s: float, short: bool) -> None:
        self._buffer.clear()
        self._spoilt = False
        self._short = short
        self._deaf = short and self.rule.needs_gap
        self._quiet_s = quiet_s

    def _by_length(self) -> list[Heard]:
        """At most one frame: what follows it without silence belongs to nothing."""
        frame = bytes(self._buffer)
        heard = self._decoded(frame)
        if heard is None:
            return []
        self._buffer.clear()
        self._deaf = len(frame) > len(heard.frame)
        return [] if self._spoilt else [heard]

    def _decoded(self, frame: bytes) -> Heard | None:
        """The frame at offset 0; None while it is incomplete. A frame that nobody may answer is dropped."""
        codec = self._codec(frame)
        try:
            verdict = codec.decode_request(frame)
        except ProtocolError as error:
            size = error.size or len(frame)
            return Heard(codec, None, error, frame[:size], _addressee(error), self._short, self._quiet_s)
        if not isinstance(verdict, Complete):
            return None
        message = verdict.message
        request = getattr(message, "request", message)
        address = codec.broadcast_address if getattr(request, "everyone", False) else codec.address_of(request)
        return Heard(codec, message, None, frame[: verdict.size], address, self._short, self._quiet_s)

    def _codec(self, frame: bytes) -> Codec:
        """C320 tells its encodings by the first byte; the others have one codec."""
        if len(self.codecs) == 1:
            return self.codecs[0]
        return self.codecs[self.rule.starts.index(frame[:1])]


def _addressee(error: ProtocolError) -> int | None:
    address = error.params.get("address")
    return address if isinstance(address, int) else None
