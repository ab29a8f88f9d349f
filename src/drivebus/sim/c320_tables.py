"""Parameters, faults and refusals of the pretend C320. Data only.

Named by appendix one: F0.1 (2 = RS485), F4.0 (1 = speed search), F1.10, F6.12, F9.3, F9.4. All other places, all
scales of times and the fault numbers are the sim's own: chapter 5 is not published.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.protocols.sifang import Response
from drivebus.sim.memory import Cell, Guard, Refusal
from drivebus.sim.motor import Trip

FREQUENCY_CHANNEL = 0x0_01
FROM_BUS = 2
START_MODE = 0x4_00
SPEED_SEARCH = 1
INPUT_CHARACTERISTIC = 0x1_0A
MONITOR_SELECTOR = 0x6_0C
KEYPAD_HZ = 0x0_02
COMMAND_CHANNEL = 0x0_03
MAXIMUM_HZ = 0x0_04
ACCEL_TIME, DECEL_TIME = 0x0_08, 0x0_09
JOG_HZ = 0x1_00

LAST_MONITOR = 37
"""d-37 is the last of the manual's table."""

RESPONSES = {
    Refusal.UNKNOWN: Response.BAD_CODE,
    Refusal.HIDDEN: Response.RESERVED,
    Refusal.READ_ONLY: Response.RESERVED,
    Refusal.PASSWORD: Response.PASSWORD,
    Refusal.RUNNING: Response.RUNNING,
    Refusal.RANGE: Response.OUT_OF_RANGE,
}
"""2.4.5."""

FAULT_CODES = {trip: number for number, trip in enumerate(Trip, start=1)}


@dataclass(frozen=True, slots=True)
class CommLoss:
    """Where a model keeps what it does when its host falls silent. The time is in 0.1 s; 0 switches the timer off."""

    time: int
    action: Cell
    place: int
    """Of the action."""
    stops: frozenset[int]
    trips: frozenset[int] = frozenset()


F9 = CommLoss(0x9_04, Cell(1, 0, 2), 0x9_03, stops=frozenset({1}), trips=frozenset({2}))
"""C320: the values of F9.3 are the sim's own."""
F4 = CommLoss(0x4_04, Cell(0, 0, 0x0011), 0x4_03, stops=frozenset({0x00, 0x01}))
"""E300 (F4.3, F4.4) and E550: the tens digit is 0 stop, 1 keep running. That a digit is four bits is the sim's own."""

_RESERVED = Cell(guard=Guard.HIDDEN)
_GROUP_SIZE = 32


def cells(step_hz: float, selector: int, comm_loss: CommLoss) -> dict[int, Cell]:
    """All sixteen groups; a place that nobody described is reserved. Commissioned: everything from RS485."""
    highest = round(400.0 / step_hz)
    table = {group << 8 | item: _RESERVED for group in range(16) for item in range(_GROUP_SIZE)}
    table |= {
        FREQUENCY_CHANNEL: Cell(FROM_BUS, 0, 9, Guard.RUNNING),
        KEYPAD_HZ: Cell(round(50.0 / step_hz), 0, highest),
        COMMAND_CHANNEL: Cell(FROM_BUS, 0, 2, Guard.RUNNING),
        MAXIMUM_HZ: Cell(round(50.0 / step_hz), round(5.0 / step_hz), highest, Guard.RUNNING),
        ACCEL_TIME: Cell(100, 1, 60000),
        DECEL_TIME: Cell(100, 1, 60000),
        JOG_HZ: Cell(round(5.0 / step_hz), 0, round(50.0 / step_hz)),
        INPUT_CHARACTERISTIC: Cell(0, 0, 0x1111),
        START_MODE: Cell(0, 0, 2, Guard.RUNNING),
        selector: Cell(0, 0, LAST_MONITOR),
        comm_loss.place: comm_loss.action,
        comm_loss.time: Cell(0, 0, 6000),
    }
    return table
