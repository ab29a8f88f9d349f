"""Steps of a drive operation: values that the generator yields and whose results it receives.

``drives/runner.py`` describes how an operation is run. No clock, event loop or port is imported by any operation.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from drivebus.bus.messages import BusRequest, BusResult

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Wait:
    """Send nothing for ``seconds``; the result is the time after it."""

    seconds: float


@dataclass(frozen=True, slots=True)
class GetBusConditions:
    """Get the BusConditions of this moment; nothing is sent."""


@dataclass(frozen=True, slots=True)
class UpdateStore:
    """Replace a stored value by ``change(value)``; durable when it returns, and atomic among programs."""

    key: str
    change: Callable[[str | None], str]


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConditions:
    """Conditions of a station's bus at one moment."""

    now: float  # monotonic seconds
    day: str = ""  # calendar day (ISO), for the EEPROM budget only
    stop_epoch: int = 0  # incremented by every stop of this station
    start_inhibited: bool = False
    foreign_master: bool = False
    duplicate_address: bool = False  # two drives seem to answer at this address
    damage_rate: float = 0.0  # share of damaged replies of the last 5 minutes, 0 to 1; a missing reply is not damaged
    reads_wait_until: float = 0.0  # monotonic seconds: the bus sends no read before, for a late reply may be due
    damaged: int = 0  # number of damaged replies of the last 5 minutes
    contact_losses: int = 0  # see ``Bus.contact_losses``
    answers: bool = True  # the station has answered its last request, or a sync probe since


GET_BUS_CONDITIONS = GetBusConditions()
OWN_FRAME = "own frame"  # tag of a stop's first frame: ``SharedTransactions`` shares it in ``submit_first`` alone
Step = BusRequest | Wait | GetBusConditions | UpdateStore
DriveOperation = Generator[Step, Any, T]


def wait(seconds: float) -> DriveOperation[float]:
    """Yield Wait and return the time after it."""
    now: float = yield Wait(seconds)
    return now


def get_bus_conditions() -> DriveOperation[BusConditions]:
    """Yield GetBusConditions and return its result."""
    conditions: BusConditions = yield GET_BUS_CONDITIONS
    return conditions


def transact(request: BusRequest) -> DriveOperation[BusResult]:
    """Yield a bus request and return its result."""
    result: BusResult = yield request
    return result


def run_pure(operation: DriveOperation[T], perform: Callable[[Step], Any]) -> T:
    """Run an operation against a function that performs each step, without an event loop: for tests."""
    try:
        step = next(operation)
        while True:
            try:
                result = perform(step)
            except Exception as error:
                step = operation.throw(error)
            else:
                step = operation.send(result)
    except StopIteration as end:
        value: T = end.value
        return value
