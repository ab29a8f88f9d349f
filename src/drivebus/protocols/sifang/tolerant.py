"""Reads C320 frames as they stand, for ``explain``: tolerant digits, nibbles, mended sums. Never for a bus."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import STRICT, TOLERANT, sum16
from drivebus.protocols.describe import Candidate, Note, check_whole, note, problem
from drivebus.protocols.sifang.codec import SifangCodec
from drivebus.protocols.sifang.frame import (
    END,
    AsciiForm,
    Fields,
    Form,
    Layout,
    MixedForm,
    PackedForm,
)
from drivebus.protocols.sifang.messages import Heard
from drivebus.protocols.sifang.tables import (
    KIND_AT,
    MonitorIndex,
    monitor_index,
    parameter_name,
)


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a profile adds: the frequency unit, and which monitors and parameters are frequencies."""

    frequency_step_hz: float = 0.01
    frequency_monitors: Collection[int] = (0,)
    """d.n by n. d.0 is the output frequency on all sisters."""
    frequency_parameters: Collection[tuple[int, int]] = ((0, 2),)
    """(group, item). F0.2 is the digital frequency [SIB]."""
    monitor_index: MonitorIndex = "binary"

    def hz(self, data: int) -> float:
        return round(data * self.frequency_step_hz, 6)


C320 = Meaning()


def digit_or_none(data: bytes, form: Form) -> int:
    try:
        return form.digit(data[KIND_AT], KIND_AT)
    except (ProtocolError, IndexError):
        return -1


def raw_fields(data: bytes, form: Form, layout: Layout) -> Fields | None:
    """The fields as they stand, with end mark and sum mended where they are wrong."""
    frame = data[: layout.size]
    if len(frame) < layout.size or frame[0] != form.head:
        return None
    total = sum16(frame[1:-5])
    sealed = b"%04X" % total if isinstance(form, AsciiForm) else total.to_bytes(4, "big")
    for attempt in (frame, frame[:-5] + sealed + bytes((END,))):
        try:
            return form.read(layout, attempt)
        except ProtocolError:
            continue
    return None


def place(kind: int, group: int, item: int, data: int | None, meaning: Meaning) -> dict[str, Any]:
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
            fields["frequency_hz"] = meaning.hz(data)
    return fields


def errata_of(data: bytes, form: Form, layout: Layout, raw: Fields) -> tuple[Note, ...]:
    """Where these bytes are not what a correct sender writes for the same numbers."""
    plain: Form = AsciiForm(STRICT) if isinstance(form, AsciiForm) else PackedForm()
    found: list[Note] = []
    written = plain.build(layout, *raw.values)
    if data[: layout.size - 5] != written[:-5] or _sum_misspelt(data[: layout.size], plain, layout):
        key = "digits" if isinstance(form, AsciiForm) else "nibbles"
        found.append(note(f"protocols.sifang.erratum.{key}"))
    if raw.other_data is not None:
        found.append(note("protocols.sifang.erratum.ambiguous", packed=raw.values[-1], nibbles=raw.other_data))
    return tuple(found)


def _sum_misspelt(frame: bytes, plain: Form, layout: Layout) -> bool:
    """The fields are canonical and the sum is right, but in another spelling."""
    tolerant: Form = AsciiForm(TOLERANT) if isinstance(plain, AsciiForm) else MixedForm()
    return reads(tolerant, layout, frame) and not reads(plain, layout, frame)


def reads(form: Form, layout: Layout, frame: bytes) -> bool:
    try:
        form.read(layout, frame)
    except ProtocolError:
        return False
    return True


def other_reading(raw: Fields) -> tuple[Candidate, ...]:
    if raw.other_data is None:
        return ()
    return (Candidate(note("protocols.sifang.reading.nibbles"), {"data": raw.other_data}),)


def heard_or_why(data: bytes, codec: SifangCodec) -> tuple[Heard | None, tuple[Note, ...]]:
    try:
        verdict = codec.decode_request(data)
        check_whole(verdict, data)
    except ProtocolError as error:
        return None, (problem(error),)
    return verdict.message, ()  # type: ignore[union-attr]
