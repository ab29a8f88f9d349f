"""Reads C320 frames as they stand, for ``explain``: tolerant digits, nibbles, mended sums. Never for a bus."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import STRICT_HEX_DIGITS, TOLERANT_HEX_DIGITS, sum16
from drivebus.protocols.describe import Interpretation, Note, error_note, note, require_whole_frame
from drivebus.protocols.sunfar.codec import SunfarCodec
from drivebus.protocols.sunfar.frame import (
    END_MARK,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    MixedFormat,
    PackedFormat,
)
from drivebus.protocols.sunfar.messages import ReceivedRequest
from drivebus.protocols.sunfar.tables import CLASS_OFFSET, MonitorIndexCoding, monitor_index, parameter_name


@dataclass(frozen=True, slots=True)
class SunfarDecodeOptions:
    """What a profile adds: the frequency unit, and which monitors and parameters are frequencies."""

    frequency_step_hz: float = 0.01
    frequency_monitors: Collection[int] = (0,)
    """d.n by n. d.0 is the output frequency on all sisters."""
    frequency_parameters: Collection[tuple[int, int]] = ((0, 2),)
    """(group, item). F0.2 is the digital frequency [SIB]."""
    monitor_index: MonitorIndexCoding = "binary"

    def to_hz(self, data: int) -> float:
        return round(data * self.frequency_step_hz, 6)


DEFAULT_DECODE_OPTIONS = SunfarDecodeOptions()


def class_digit(data: bytes, form: FieldFormat) -> int:
    try:
        return form.digit(data[CLASS_OFFSET], CLASS_OFFSET)
    except (ProtocolError, IndexError):
        return -1


def unchecked_fields(data: bytes, form: FieldFormat, layout: FrameLayout) -> FrameFields | None:
    """The fields as they stand, with end mark and sum mended where they are wrong."""
    frame = data[: layout.size]
    if len(frame) < layout.size or frame[0] != form.head:
        return None
    total = sum16(frame[1:-5])
    sealed = b"%04X" % total if isinstance(form, AsciiFormat) else total.to_bytes(4, "big")
    for attempt in (frame, frame[:-5] + sealed + bytes((END_MARK,))):
        try:
            return form.read(layout, attempt)
        except ProtocolError:
            continue
    return None


def locate_value(kind: int, group: int, item: int, data: int | None, meaning: SunfarDecodeOptions) -> dict[str, Any]:
    """Whose value it is, in the manual's notation, and the frequency where it is one."""
    fields: dict[str, Any] = {}
    if kind in (1, 4):
        index = monitor_index(item, meaning.monitor_index)
        fields["monitor"] = f"d.{index}"
        frequency = index in meaning.frequency_monitors
    elif kind in (2, 3, 5):
        fields["parameter"] = parameter_name(group, item)
        frequency = (group, item) in meaning.frequency_parameters
    else:
        return fields
    if data is not None:
        fields["data"] = data
        if frequency:
            fields["frequency_hz"] = meaning.to_hz(data)
    return fields


def frame_errata(data: bytes, form: FieldFormat, layout: FrameLayout, raw: FrameFields) -> tuple[Note, ...]:
    """Where these bytes are not what a correct sender writes for the same numbers."""
    plain: FieldFormat = AsciiFormat(STRICT_HEX_DIGITS) if isinstance(form, AsciiFormat) else PackedFormat()
    found: list[Note] = []
    written = plain.build(layout, *raw.values)
    if data[: layout.size - 5] != written[:-5] or _is_checksum_misspelled(data[: layout.size], plain, layout):
        key = "digits" if isinstance(form, AsciiFormat) else "nibbles"
        found.append(note(f"protocols.sifang.erratum.{key}"))
    if raw.nibble_data is not None:
        found.append(note("protocols.sifang.erratum.ambiguous", packed=raw.values[-1], nibbles=raw.nibble_data))
    return tuple(found)


def _is_checksum_misspelled(frame: bytes, plain: FieldFormat, layout: FrameLayout) -> bool:
    """The fields are canonical and the sum is right, but in another spelling."""
    tolerant: FieldFormat = AsciiFormat(TOLERANT_HEX_DIGITS) if isinstance(plain, AsciiFormat) else MixedFormat()
    return is_readable(tolerant, layout, frame) and not is_readable(plain, layout, frame)


def is_readable(form: FieldFormat, layout: FrameLayout, frame: bytes) -> bool:
    try:
        form.read(layout, frame)
    except ProtocolError:
        return False
    return True


def nibble_interpretation(raw: FrameFields) -> tuple[Interpretation, ...]:
    if raw.nibble_data is None:
        return ()
    return (Interpretation(note("protocols.sifang.reading.nibbles"), {"data": raw.nibble_data}),)


def decode_or_problems(data: bytes, codec: SunfarCodec) -> tuple[ReceivedRequest | None, tuple[Note, ...]]:
    try:
        verdict = codec.decode_request(data)
        require_whole_frame(verdict, data)
    except ProtocolError as error:
        return None, (error_note(error),)
    return verdict.message, ()  # type: ignore[union-attr]
