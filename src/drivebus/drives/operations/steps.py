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

from drivebus.bus.messages import BusRequest, BusResult

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing for so many seconds."""

    seconds: float


@dataclass(frozen=True, slots=True)
class GetBusConditions:
    """Ask for the surroundings; sends nothing."""


@dataclass(frozen=True, slots=True)
class UpdateStore:
    """Change a stored value so that it survives a power cut, and so that no other program changes it in between."""

    key: str
    change: Callable[[str | None], str]


@dataclass(frozen=True, slots=True)
class BusConditions:
    """What the bus knows of the station at this moment."""

    now: float
    """Monotonic seconds."""
    day: str = ""
    """Calendar day (ISO), for the EEPROM budget only."""
    stop_epoch: int = 0
    """Stop generation: it grows with every stop of this station (6.5)."""
    start_inhibited: bool = False
    foreign_master: bool = False
    duplicate: bool = False
    error_rate: float = 0.0
    """Share of this station's replies of the last 5 minutes that came spoiled, 0 to 1. Silence is no bit error."""
    failures: int = 0
    """How many those were."""


GET_BUS_CONDITIONS = GetBusConditions()
Step = BusRequest | Wait | GetBusConditions | UpdateStore
DriveOperation = Generator[Step, Any, T]


def wait(seconds: float) -> DriveOperation[float]:
    """Typed ``yield Wait``: returns the monotonic second after it."""
    now: float = yield Wait(seconds)
    return now


def get_bus_conditions() -> DriveOperation[BusConditions]:
    """Typed ``yield LOOK``."""
    seen: BusConditions = yield GET_BUS_CONDITIONS
    return seen


def transact(request: BusRequest) -> DriveOperation[BusResult]:
    """Typed ``yield Ask``."""
    answer: BusResult = yield request
    return answer


def run_pure(operation: DriveOperation[T], perform: Callable[[Step], Any]) -> T:
    """Run a conversation against a function that performs each step: for tests and simulations without a loop."""
    try:
        step = next(operation)
        while True:
            try:
                found = perform(step)
            except Exception as error:
                step = operation.throw(error)
            else:
                step = operation.send(found)
    except StopIteration as end:
        result: T = end.value
        return result
