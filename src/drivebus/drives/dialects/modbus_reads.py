"""Reads of a Modbus drive: spans of registers and coils, merged into few requests, and the sync probes among them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from drivebus.errors import ConfigurationError
from drivebus.profiles.model import DriveProfile, ModbusFeatures, Parameter, Signal
from drivebus.profiles.spaces import BIT_SPACES, READ_FUNCTION_BY_SPACE, SYNC_READ_COUNT
from drivebus.profiles.words import StatusMap
from drivebus.protocols.family import Locator
from drivebus.protocols.modbus import BitValues, ReadBits, ReadRegisters, RegisterValues

ReadRequest = ReadRegisters | ReadBits
MAX_MERGE_PERIOD_RATIO = 4.0
"""Registers whose periods differ by more are not merged."""
MAX_BITS = 16
"""Coils of one read: every station that has coils allows so many, and a status word has no more."""
SPACES = {function: space for space, function in READ_FUNCTION_BY_SPACE.items()}
"""Function of a read to the space that it reads."""
SYNC_SPACES = ("holding", "input")
"""Spaces whose reads can be sync probes, in order of preference: a reply of bits has its length in octets only."""


class Span(NamedTuple):
    """Neighbouring registers or coils of one space that are read together."""

    space: str
    start: int
    length: int = 1

    @property
    def end(self) -> int:
        """Place behind the last one."""
        return self.start + self.length

    def covers(self, other: Span) -> bool:
        """Return whether all of another span is in this one."""
        return self.space == other.space and self.start <= other.start and other.end <= self.end

    def request(self, address: int) -> ReadRequest:
        """Return the request that reads the span."""
        kind = ReadBits if self.space in BIT_SPACES else ReadRegisters
        return kind(address, self.start, self.length, READ_FUNCTION_BY_SPACE[self.space])


def span_of(entry: Signal | Parameter) -> Span:
    """Return the registers of a signal or parameter."""
    return Span(*entry.locator, entry.scale.words)


def status_span(status: StatusMap) -> Span:
    """Return the register of the status word, or the coils that are its bits."""
    return Span(status.space, status.register, status.bit_count if status.space in BIT_SPACES else 1)


def whole_span(span: Span, features: ModbusFeatures) -> Span:
    """Return the block that has a span and is read only as a whole, else the span."""
    blocks = (Span("holding", first, count) for first, count in features.blocks)
    return next((block for block in blocks if block.covers(span)), span)


def request_span(request: ReadRequest) -> Span:
    """Return the span that a request reads."""
    return Span(SPACES[request.function], request.register, request.count)


def reply_values(request: ReadRequest, reply: RegisterValues | BitValues) -> dict[Locator, int]:
    """Return the registers of a reply, or its coils as 0 and 1, by locator."""
    space = SPACES[request.function]
    return {(space, request.register + place): int(value) for place, value in enumerate(reply.values)}


def span_value(span: Span, values: Mapping[Locator, int], features: ModbusFeatures) -> int | None:
    """Return the number in a span: registers in the model's word order, coils with the first in the lowest bit.

    None where the values lack a part of it.
    """
    if span.length == 1:
        return values.get((span.space, span.start))
    numbers = [values.get((span.space, index)) for index in range(span.start, span.end)]
    parts = [part for part in numbers if part is not None]
    if len(parts) != span.length:
        return None
    if span.space in BIT_SPACES:
        return sum(bit << place for place, bit in enumerate(parts))
    return join_words(parts, features)


def join_words(words: Iterable[int], features: ModbusFeatures) -> int:
    """Return the number in neighbouring registers, by the model's word order."""
    ordered = list(words) if features.word_order == "high_first" else list(words)[::-1]
    number = 0
    for word in ordered:
        number = number << 16 | word
    return number


def split_words(number: int, count: int, features: ModbusFeatures) -> tuple[int, ...]:
    """Return the registers of a number, by the model's word order."""
    words = tuple(number >> 16 * place & 0xFFFF for place in reversed(range(count)))
    return words if features.word_order == "high_first" else words[::-1]


def merge_reads(
    periods: Mapping[Span, float], features: ModbusFeatures, sync: Span | None
) -> tuple[tuple[Span, float], ...]:
    """Merge touching spans of a space into reads within the model's limit, at the shortest period of each run.

    ``sync``: sync probes are recognized in its space by their count, so no other read of it may have that count.
    """
    runs: list[tuple[Span, float]] = []
    needed: dict[Span, float] = {}
    for span, period in periods.items():
        whole = whole_span(span, features)
        needed[whole] = min(needed.get(whole, period), period)
    for span, period in sorted(needed.items()):
        last = runs[-1] if runs else None
        if last is not None and _can_merge(last, span, period, features):
            runs[-1] = _joined(last[0], span), min(last[1], period)
        else:
            runs.append((span, period))
    return tuple((part, period) for span, period in runs for part in _split_sync_count(span, sync))


def _joined(first: Span, second: Span) -> Span:
    return first._replace(length=max(first.end, second.end) - first.start)


def _can_merge(run: tuple[Span, float], span: Span, period: float, features: ModbusFeatures) -> bool:
    """Return whether a span joins a run: two more bytes cost less than a frame, unless read far less often."""
    last, shortest = run
    if last.covers(span):
        return True
    if any(part.space == "holding" and (part.start, part.length) in features.blocks for part in (last, span)):
        return False
    limit = MAX_BITS if span.space in BIT_SPACES else features.max_read
    touches = last.space == span.space and span.start <= last.end and _joined(last, span).length <= limit
    return touches and max(period, shortest) <= MAX_MERGE_PERIOD_RATIO * min(period, shortest)


def _split_sync_count(span: Span, sync: Span | None) -> tuple[Span, ...]:
    if sync is None or (span.space, span.length) != (sync.space, sync.length):
        return (span,)
    return span._replace(length=1), Span(span.space, span.start + 1, span.length - 1)


def sync_spans(profile: DriveProfile) -> tuple[Span, ...]:
    """Return touching pairs of one space that are read anyway, around preconditions and ramp times.

    A model with a block for it has that, read by function 04. Raises ConfigurationError where the profile has none.
    """
    if profile.modbus_features.sync_block is not None:
        return (Span("input", *profile.modbus_features.sync_block),)
    for space in SYNC_SPACES:
        spans = _sync_spans_in(profile, space)
        if spans:
            return spans
    raise ConfigurationError("drives.no_sync_probe", model=profile.model)


def _sync_spans_in(profile: DriveProfile, space: str) -> tuple[Span, ...]:
    notations = [p.notation for p in profile.preconditions] + list(profile.ramp_notations or ())
    entries: list[Signal | Parameter] = [*profile.signals.values()]
    entries += [profile.parameters[name] for name in notations if name in profile.parameters]
    signal_registers = {entry.locator[1] for entry in entries if entry.locator[0] == space}
    if profile.status is not None and profile.status.space == space:
        signal_registers.add(profile.status.register)
    readable = {p.locator[1] for p in profile.parameters.values() if p.readable and p.locator[0] == space}
    blocks = profile.modbus_features.blocks if space == "holding" else ()
    readable_registers = (readable | signal_registers) - {
        register for first, count in blocks for register in range(first, first + count)
    }
    pairs: list[Span] = []
    for index in sorted(readable_registers):
        touches = index + 1 in readable_registers and (index in signal_registers or index + 1 in signal_registers)
        if touches and (not pairs or index >= pairs[-1].end):
            pairs.append(Span(space, index, SYNC_READ_COUNT))
    return tuple(pairs)
