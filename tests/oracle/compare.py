"""Comparison of the reference codecs with the product's on the same messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import Any

from oracle.c320_side import C320Comparison
from oracle.dzb100_side import Dzb100Comparison

MAX_LISTED_DISAGREEMENTS = 20
"""So many disagreements are kept in full; the rest is counted."""
ComparedSide = C320Comparison | Dzb100Comparison


@dataclass(slots=True)
class ComparisonTally:
    """What came of one comparison."""

    kinds: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(request kind, what happened)."""
    mutations: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(what became of the reply, accepted or refused by both, or else)."""
    choices: Counter[str] = field(default_factory=Counter)
    disagreements: list[str] = field(default_factory=list)
    disagreed: int = 0

    def disagree(self, kind: str, text: str) -> None:
        self.kinds[kind, "disagreements"] += 1
        self.disagreed += 1
        if len(self.disagreements) < MAX_LISTED_DISAGREEMENTS:
            self.disagreements.append(text)


def sides() -> list[ComparedSide]:
    return [C320Comparison("ascii"), C320Comparison("hex"), Dzb100Comparison()]


def compare(side: ComparedSide, rng: Random, count: int) -> ComparisonTally:
    """``count`` replies judged, each after its request was built by both; more requests where none can be asked."""
    tally = ComparisonTally()
    judged = 0
    while judged < count:
        asked = side.draw(rng)
        request = _request(side, rng, asked, tally)
        if request is not None:
            _reply(side, rng, asked, request, tally)
            judged += 1
    return tally


def _request(side: ComparedSide, rng: Random, asked: dict[str, Any], tally: ComparisonTally) -> bytes | None:
    """The request to be answered; None where there is none, or where it is a choice of ours."""
    kind, plain, ours = side.kind(asked), side.reference_request(asked), side.product_request(asked)
    choice, wanted = side.wanted_request(asked, plain)
    if ours != wanted:
        tally.disagree(kind, f"{kind} request {asked}: reference {_hex(plain)}, product {_hex(ours)}")
        return None
    if choice is not None:
        tally.choices[choice] += 1
        return None
    tally.kinds[kind, "not built" if plain is None else "built"] += 1
    if plain is not None and not side.station_reads(rng, asked):
        tally.disagree(kind, f"{kind} request {asked}: heard differently at the station")
    return plain


def _reply(side: ComparedSide, rng: Random, asked: dict[str, Any], request: bytes, tally: ComparisonTally) -> None:
    kind, hand = side.kind(asked), "as sent"
    reply = side.random_reply(rng, asked)
    if rng.randrange(3):
        chosen = rng.choice((*side.mutations, echo))
        hand = chosen.__name__
        reply = request if chosen is echo else chosen(rng, reply)
    plain, ours = side.reference_verdict(request, reply), side.product_verdict(asked, reply)
    choice, wanted = side.wanted_reply(asked, request, reply, plain)
    word = "refused" if plain == "refuse" else "accepted"
    if ours != wanted:
        word = "disagreements"
        tally.disagree(kind, f"{kind} {hand}: {_hex(request)}, reply {_hex(reply)}: reference {plain}, product {ours}")
    elif choice is not None:
        word = "chosen"
        tally.choices[choice] += 1
    if word != "disagreements":
        tally.kinds[kind, word] += 1
    tally.mutations[hand, word] += 1


def echo(rng: Random, frame: bytes) -> bytes:
    """Our own request comes back; ``compare`` puts it in place of the reply."""
    return frame


def _hex(frame: bytes | None) -> str:
    return "nothing" if frame is None else frame.hex(" ").upper() or "no byte"
