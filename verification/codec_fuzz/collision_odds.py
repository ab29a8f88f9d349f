"""How often chance alone must hit a lawful frame: the lambda that false accepts are compared with.

For a frame of which some bytes were drawn by chance, the probability is, summed over the lawful forms that the other
bytes allow, the share of values that may stand at each drawn place, times that of the check:

- all of the check drawn: its spellings / all values, exactly (the rest being given, one value fits);
- DZB100: no check, 1;
- else, sum and LRC: the rest being given, one value of one byte fits at most (tolerant digits: 3, two readings: 2);
- else, CRC: as many as its equations have solutions, exactly, for it is linear.

Where a field's bytes depend on each other (two digits of a state) each counts by itself. So this is an upper bound, and
exact where it matters most: noise, and a garbled end. The damaged frame itself, hit again, is no false accept.
"""

from __future__ import annotations

from functools import cache
from math import prod, sqrt

from verification.reference.frame_shapes import FrameShape
from verification.reference.modbus import reference_crc

NEAR_FORMS_MISFITS = 3
"""Forms that differ in more places than ever are substituted can't be hit."""


class CollisionOdds:
    """For one lawful frame and the forms that it might be taken for."""

    def __init__(self, frame: bytes, forms: tuple[FrameShape, ...], alphabet: bytes, marks: int) -> None:
        self.frame, self.alphabet, self.marks = frame, frozenset(alphabet), marks
        self.forms = tuple(form for form in forms if form.size <= len(frame))
        self._tails: dict[int, float] = {}
        self._near: tuple[tuple[FrameShape, frozenset[int]], ...] | None = None

    def garbled(self, start: int) -> float:
        """Every byte from ``start`` on, but for the end marks, was drawn from the alphabet."""
        if start not in self._tails:
            self._tails[start] = sum(self._tail(form, start) for form in self.forms)
        return self._tails[start]

    def _tail(self, form: FrameShape, start: int) -> float:
        end = min(form.size, len(self.frame) - self.marks)
        fixed = (*range(min(start, form.size)), *range(end, form.size))
        if start >= form.size or any(self.frame[place] not in form.places[place] for place in fixed):
            return 0.0
        whole = form.size == len(self.frame) and form.matches(self.frame)
        itself = whole and (start in form.check or self.alphabet.issuperset(self.frame[start:end]))
        return _drawn_probability(form, range(start, end), self.alphabet) - itself * float(len(self.alphabet)) ** (
            start - end
        )

    def substituted(self, places: tuple[int, ...]) -> float:
        """The bytes at ``places`` were changed for any others."""
        if self._near is None:
            self._near = tuple(
                (form, wrong) for form in self.forms if len(wrong := _misfits(form, self.frame)) <= NEAR_FORMS_MISFITS
            )
        return sum(self._changed(form, places) for form, wrong in self._near if wrong.issubset(places))

    def _changed(self, form: FrameShape, places: tuple[int, ...]) -> float:
        inside = [place for place in places if place < form.size]
        if not inside:
            return 0.0
        others = {place: form.places[place] - {self.frame[place]} for place in inside}
        hits = prod(map(len, others.values()))
        if hits and form.check_rule != "none":
            same = form.size == len(self.frame)
            counted = _crc_hits(form, self.frame, others) if form.check_rule == "crc" else _sum_hits(form, others, same)
            hits = min(hits, counted)
        return float(hits / 255 ** len(inside))


def _sum_hits(form: FrameShape, others: dict[int, frozenset[int]], same: bool) -> int:
    """Of all values of the changed bytes, so many make the check right at most; ``same``: so did the old ones."""
    if same and (len(others) == 1 or form.check.start <= min(others) <= max(others) < form.check.stop):
        return int(min(form.checksum_spellings, form.byte_spellings ** len(others))) - 1
    rest = sorted(map(len, others.values()))
    return int(prod(rest[:-1]) * min(rest[-1], form.byte_spellings))


def _crc_hits(form: FrameShape, frame: bytes, others: dict[int, frozenset[int]]) -> int:
    """The same for a CRC: bytes with one other value have it, and the free ones must make up for what that does."""
    forced = {place: min(values) for place, values in others.items() if len(values) == 1}
    changed = bytes(forced.get(place, byte) for place, byte in enumerate(frame[: form.size]))
    free = tuple(form.size - place for place in others if place not in forced)
    left = 0 if changed == frame else reference_crc(changed)
    basis = _basis(free)
    for known in basis:
        left = min(left, left ^ known)
    return 0 if left else 2 ** (8 * len(free) - len(basis)) - (changed == frame)


def noise_odds(forms: tuple[FrameShape, ...]) -> tuple[tuple[int, float], ...]:
    """(size, probability that any bytes of at least this size are the form) of each form."""
    everything = frozenset(range(256))
    return tuple((form.size, _drawn_probability(form, range(form.size), everything)) for form in forms)


def _drawn_probability(form: FrameShape, drawn: range, alphabet: frozenset[int]) -> float:
    """All of ``drawn`` came from the alphabet; it reaches into the check or ends behind it."""
    content = [len(form.places[place] & alphabet) / len(alphabet) for place in drawn if place not in form.check]
    check = len([place for place in drawn if place in form.check])
    spellings = min(form.checksum_spellings, form.byte_spellings**check)
    return float(prod(content) * spellings / len(alphabet) ** check)


def _misfits(form: FrameShape, frame: bytes) -> frozenset[int]:
    return frozenset(place for place, may in enumerate(form.places) if frame[place] not in may)


@cache
def _basis(from_end: tuple[int, ...]) -> tuple[int, ...]:
    """Of what bits in the bytes that stand so far from a frame's end do to its CRC."""
    basis: list[int] = []
    for distance in from_end:
        for bit in range(8):
            pattern = reference_crc(bytes((1 << bit,)).ljust(distance, b"\0")) ^ reference_crc(bytes(distance))
            for known in basis:
                pattern = min(pattern, pattern ^ known)
            if pattern:
                basis.append(pattern)
    return tuple(basis)


def false_accept_limit(expected: float) -> float:
    """No more false accepts than this."""
    return expected + 4 * sqrt(expected) + 3
