"""Probability that random damage makes a valid frame, as the expected number of false accepts.

The probability is the sum, over the valid shapes that the unchanged bytes allow, of the share of allowed values at each
random place times the share of correct checks. The share of checks is exact where the whole check is random and for a
CRC, whose equations are linear; for a sum or LRC one value of one byte fits at most.

Dependent bytes of a field count independently, so the result is an upper bound, and exact for noise and a garbled end.
The original frame is no false accept.
"""

from __future__ import annotations

from functools import cache
from math import prod, sqrt

from verification.reference.frame_shapes import FrameShape
from verification.reference.modbus import reference_crc

NEAR_FORMS_MISFITS = 3
"""Largest number of differing places of a shape that a substitution can reach."""


class CollisionOdds:
    """Odds for one valid frame and the shapes that it may be mistaken for."""

    def __init__(self, frame: bytes, forms: tuple[FrameShape, ...], alphabet: bytes, marks: int) -> None:
        self.frame, self.alphabet, self.marks = frame, frozenset(alphabet), marks
        self.forms = tuple(form for form in forms if form.size <= len(frame))
        self._tails: dict[int, float] = {}
        self._near: tuple[tuple[FrameShape, frozenset[int]], ...] | None = None

    def garbled(self, start: int) -> float:
        """Return the odds where every byte from ``start`` on, except the end marks, is random."""
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
        """Return the odds where the bytes at ``places`` were replaced by others."""
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
            counted = (
                _crc_hits(form, self.frame, others) if form.check_rule == "crc" else _sum_hits(form, others, same=same)
            )
            hits = min(hits, counted)
        return float(hits / 255 ** len(inside))


def _sum_hits(form: FrameShape, others: dict[int, frozenset[int]], *, same: bool) -> int:
    """Return the largest number of values of the changed bytes with a correct sum; ``same``: the old ones had one."""
    if same and (len(others) == 1 or form.check.start <= min(others) <= max(others) < form.check.stop):
        return int(min(form.checksum_spellings, form.byte_spellings ** len(others))) - 1
    rest = sorted(map(len, others.values()))
    return int(prod(rest[:-1]) * min(rest[-1], form.byte_spellings))


def _crc_hits(form: FrameShape, frame: bytes, others: dict[int, frozenset[int]]) -> int:
    """Return the number of values of the changed bytes with a correct CRC."""
    forced = {place: min(values) for place, values in others.items() if len(values) == 1}
    changed = bytes(forced.get(place, byte) for place, byte in enumerate(frame[: form.size]))
    free = tuple(form.size - place for place in others if place not in forced)
    left = 0 if changed == frame else reference_crc(changed)
    basis = _basis(free)
    for known in basis:
        left = min(left, left ^ known)
    return 0 if left else 2 ** (8 * len(free) - len(basis)) - (changed == frame)


def noise_odds(forms: tuple[FrameShape, ...]) -> tuple[tuple[int, float], ...]:
    """Return for each shape its size and the probability that random bytes match it."""
    everything = frozenset(range(256))
    return tuple((form.size, _drawn_probability(form, range(form.size), everything)) for form in forms)


def _drawn_probability(form: FrameShape, drawn: range, alphabet: frozenset[int]) -> float:
    """Return the probability that random bytes at ``drawn`` match the shape."""
    content = [len(form.places[place] & alphabet) / len(alphabet) for place in drawn if place not in form.check]
    check = len([place for place in drawn if place in form.check])
    spellings = min(form.checksum_spellings, form.byte_spellings**check)
    return float(prod(content) * spellings / len(alphabet) ** check)


def _misfits(form: FrameShape, frame: bytes) -> frozenset[int]:
    return frozenset(place for place, may in enumerate(form.places) if frame[place] not in may)


@cache
def _basis(from_end: tuple[int, ...]) -> tuple[int, ...]:
    """Return a basis of the CRC changes by bits at these distances from the frame's end."""
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
    """Return the largest acceptable number of false accepts."""
    return expected + 4 * sqrt(expected) + 3
