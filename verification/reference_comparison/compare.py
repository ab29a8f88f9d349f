"""Comparison of one reference codec with the product's codec: the same requests, the same replies."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import Any

from verification.reference_comparison.c320 import C320Comparison
from verification.reference_comparison.dzb100 import Dzb100Comparison

MAX_LISTED_DISAGREEMENTS = 20
"""Disagreements listed in full; the rest is counted."""
ComparedSide = C320Comparison | Dzb100Comparison


@dataclass(slots=True)
class ComparisonTally:
    """Counts of one comparison."""

    kinds: Counter[tuple[str, str]] = field(default_factory=Counter)
    """By kind of request and result."""
    mutations: Counter[tuple[str, str]] = field(default_factory=Counter)
    """By mutation of the reply and result."""
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
    """Compare ``count`` replies, each to a request that both codecs build alike."""
    tally = ComparisonTally()
    judged = 0
    while judged < count:
        fields = side.draw(rng)
        request = _request(side, rng, fields, tally)
        if request is not None:
            _reply(side, rng, fields, request, tally)
            judged += 1
    return tally


def _request(side: ComparedSide, rng: Random, fields: dict[str, Any], tally: ComparisonTally) -> bytes | None:
    """Return the request to reply to; None where both reject it, or where the product deviates on purpose."""
    kind, by_reference, by_product = side.kind(fields), side.reference_request(fields), side.product_request(fields)
    choice, wanted = side.wanted_request(fields, by_reference)
    if by_product != wanted:
        tally.disagree(kind, f"{kind} request {fields}: reference {_hex(by_reference)}, product {_hex(by_product)}")
        return None
    if choice is not None:
        tally.choices[choice] += 1
        return None
    tally.kinds[kind, "not built" if by_reference is None else "built"] += 1
    if by_reference is not None and not side.station_reads(rng, fields):
        tally.disagree(kind, f"{kind} request {fields}: decoded differently at the station")
    return by_reference


def _reply(side: ComparedSide, rng: Random, fields: dict[str, Any], request: bytes, tally: ComparisonTally) -> None:
    kind, mutation = side.kind(fields), "as sent"
    reply = side.random_reply(rng, fields)
    if rng.randrange(3):
        chosen = rng.choice((*side.mutations, echo))
        mutation = chosen.__name__
        reply = request if chosen is echo else chosen(rng, reply)
    by_reference, by_product = side.reference_verdict(request, reply), side.product_verdict(fields, reply)
    choice, wanted = side.wanted_reply(fields, request, reply, by_reference)
    word = "refused" if by_reference == "refuse" else "accepted"
    if by_product != wanted:
        word = "disagreements"
        tally.disagree(
            kind,
            f"{kind} {mutation}: {_hex(request)}, reply {_hex(reply)}: reference {by_reference}, product {by_product}",
        )
    elif choice is not None:
        word = "chosen"
        tally.choices[choice] += 1
    if word != "disagreements":
        tally.kinds[kind, word] += 1
    tally.mutations[mutation, word] += 1


def echo(rng: Random, frame: bytes) -> bytes:
    """Mark an echo: ``_reply`` uses the request in place of the reply."""
    return frame


def _hex(frame: bytes | None) -> str:
    return "nothing" if frame is None else frame.hex(" ").upper() or "no byte"
