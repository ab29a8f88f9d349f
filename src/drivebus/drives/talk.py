"""The steps of a conversation: what a pure operation may ask of the world. Values only; the shells perform them.

A conversation is a generator: it yields a step and is sent what came of it.

    Ask(...)      → Answer            one transaction on the bus
    Wait(s)       → now               silence on our side
    LOOK          → Surroundings      time, stop generation, latch and health, at this moment
    Keep(k, f)    → None              f(what is kept now) is durable when it returns (EEPROM wear); f may raise

No clock, loop or port is imported here or by any conversation.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from drivebus.message import Answer, Ask

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing for so many seconds."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Look:
    """Ask for the surroundings; sends nothing."""


@dataclass(frozen=True, slots=True)
class Keep:
    """Change a stored value so that it survives a power cut, and so that no other program changes it in between."""

    key: str
    change: Callable[[str | None], str]


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the bus knows of the station at this moment."""

    now: float
    """Monotonic seconds."""
    day: str = ""
    """Calendar day (ISO), for the EEPROM budget only."""
    generation: int = 0
    """Stop generation: it grows with every stop of this station (6.5)."""
    latched: bool = False
    foreign_master: bool = False
    duplicate: bool = False
    error_rate: float = 0.0
    """Share of this station's replies of the last 5 minutes that came spoiled, 0 to 1. Silence is no bit error."""
    failures: int = 0
    """How many those were."""


LOOK = Look()
Step = Ask | Wait | Look | Keep
Conversation = Generator[Step, Any, T]


def wait(seconds: float) -> Conversation[float]:
    """Typed ``yield Wait``: returns the monotonic second after it."""
    now: float = yield Wait(seconds)
    return now


def look() -> Conversation[Surroundings]:
    """Typed ``yield LOOK``."""
    seen: Surroundings = yield LOOK
    return seen


def ask(step: Ask) -> Conversation[Answer]:
    """Typed ``yield Ask``."""
    answer: Answer = yield step
    return answer


def play(conversation: Conversation[T], world: Callable[[Step], Any]) -> T:
    """Run a conversation against a function that performs each step: for tests and simulations without a loop."""
    try:
        step = next(conversation)
        while True:
            try:
                found = world(step)
            except Exception as error:
                step = conversation.throw(error)
            else:
                step = conversation.send(found)
    except StopIteration as end:
        result: T = end.value
        return result
