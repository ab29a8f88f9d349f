"""One block of garbage for one codec: drawn, fed, judged, counted. A block is a function of seed, codec and number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from random import Random

from drivebus.lab.codecs.feed import Decode, Outcome, Refusal, feed, taken
from drivebus.lab.codecs.judges.forms import Form
from drivebus.lab.codecs.mutate import KINDS, WEIGHTS, Base
from drivebus.lab.codecs.odds import Odds, noise
from drivebus.lab.codecs.roster import ROSTER, Entry
from drivebus.lab.codecs.talk import Exchange

SIZE = 200_000
"""Bytes of a block."""
POOL = 48
"""Exchanges whose frames one block damages."""
RECKONED = ("noise", "garbled", "substituted")
"""Kinds of damage whose odds are known; what the others bring through is lawful by the judge or a violation."""


@dataclass(slots=True)
class Found:
    """What one or more blocks of a codec came to."""

    bytes: int = 0
    frames: Counter[str] = field(default_factory=Counter)
    """By kind of damage."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """By verdict or error."""
    accepted: Counter[str] = field(default_factory=Counter)
    """By kind of damage: taken, and not the frame that had been damaged."""
    expected: dict[str, float] = field(default_factory=lambda: dict.fromkeys(RECKONED, 0.0))
    """So many of them chance alone would bring, at most."""
    lines: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)

    def add(self, other: Found) -> None:
        """Take another block's numbers; its lines and violations are the caller's to tell."""
        self.bytes += other.bytes
        self.frames.update(other.frames)
        self.outcomes.update(other.outcomes)
        self.accepted.update(other.accepted)
        for kind, chance in other.expected.items():
            self.expected[kind] += chance


@dataclass(frozen=True, slots=True)
class Target:
    """One side of one exchange, as it is tried."""

    decode: Decode
    sent: bytes
    """Of the request that is answered; empty at a station."""
    frame: bytes
    odds: Odds
    noise: tuple[tuple[int, float], ...]


@cache
def _noise_at_station(name: str) -> tuple[tuple[int, float], ...]:
    return noise(ROSTER[name].forms(b""))


def targets(entry: Entry, exchange: Exchange) -> tuple[Target, Target]:
    """The host's side and the station's."""

    def odds(frame: bytes, forms: tuple[Form, ...]) -> Odds:
        return Odds(frame, forms, entry.alphabet, entry.judge.marks)

    replies, requests = entry.forms(exchange.sent), entry.forms(b"")
    host = partial(entry.codec.decode_reply, exchange.request)
    return (
        Target(host, exchange.sent, exchange.received, odds(exchange.received, replies), noise(replies)),
        Target(
            entry.codec.decode_request, b"", exchange.sent, odds(exchange.sent, requests), _noise_at_station(entry.name)
        ),
    )


def block(entry: Entry, rng: Random, size: int = SIZE) -> Found:
    """Damaged frames until ``size`` bytes are used, each byte counted once however often it is fed."""
    found = Found()
    pool = [targets(entry, entry.exchange(rng)) for _ in range(POOL)]
    kinds, digest = list(KINDS), sha256()
    while found.bytes < size:
        side = rng.random() > 2 / 3
        target, other = pool[rng.randrange(POOL)][side], pool[rng.randrange(POOL)][rng.random() > 0.7]
        kind = rng.choices(kinds, WEIGHTS)[0]
        base = Base(target.frame, other.frame, entry.alphabet, entry.judge.marks, entry.judge.seal)
        data, places = KINDS[kind](rng, base)
        found.bytes += len(data)
        found.frames[kind] += 1
        if kind in RECKONED:
            found.expected[kind] += expected(entry, target, kind, data, places)
        digest.update(_try(entry, target, kind, data, rng.random(), found))
    totals = f"{sum(found.frames.values())} frames {found.bytes} bytes {sum(found.accepted.values())} taken"
    found.lines.append(f"{totals} {digest.hexdigest()[:16]}")
    return found


def expected(entry: Entry, target: Target, kind: str, data: bytes, places: Sequence[int]) -> float:
    """The probability, at most, that damage of this kind makes another frame that is lawful."""
    if kind == "garbled":
        return target.odds.garbled(places[0])
    if kind == "substituted":
        return target.odds.substituted(tuple(places))
    shifts = 1 + getattr(entry.judge, "resync", 0)
    return shifts * sum(chance for size, chance in target.noise if size <= len(data))


def _try(entry: Entry, target: Target, kind: str, data: bytes, cut: float, found: Found) -> bytes:
    """Feed and judge one frame; what came of it, for the digest."""
    try:
        what, wrong = feed(target.decode, data, cut, entry.longest)
    except Exception as error:
        found.violations.append(f"I8 {_told(entry, target, kind, data)}: {type(error).__name__}: {error}")
        return b"escaped"
    if wrong:
        found.violations.append(f"G01 {_told(entry, target, kind, data)}: {wrong}")
    size = taken(what, data)
    lawful = entry.judge.size(target.sent, data)
    if size != lawful:
        found.violations.append(f"G02 {_told(entry, target, kind, data)}: codec takes {size}, judge {lawful}; {what}")
    name = what.kind if isinstance(what, Refusal) else type(what).__name__
    found.outcomes[name] += 1
    if size is not None:
        _taken(entry, target, kind, data, what, size, found)
    return name.encode() + data


def _taken(entry: Entry, target: Target, kind: str, data: bytes, what: Outcome, size: int, found: Found) -> None:
    if target.sent:
        try:
            entry.meant(what.message)  # type: ignore[union-attr]
        except Exception as error:
            found.violations.append(f"I8 {_told(entry, target, kind, data)}: {type(error).__name__}: {error}")
    if data[:size] == target.frame[: len(data)]:
        return
    found.accepted[kind] += 1
    if kind in RECKONED:
        found.lines.append(f"taken {_told(entry, target, kind, data)}: {size}")


def _told(entry: Entry, target: Target, kind: str, data: bytes) -> str:
    side = f"reply to {target.sent.hex(' ')}" if target.sent else "request"
    return f"{entry.name} {side}: {kind} {data.hex(' ')}"
