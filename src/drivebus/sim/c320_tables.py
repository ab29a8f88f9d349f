"""Parameters, faults and refusals of the pretend C320. Data only.

Named by appendix one: F0.1 (2 = RS485), F4.0 (1 = speed search), F1.10, F6.12, F9.3, F9.4. All other places, all
scales of times and the fault numbers are the sim's own: chapter 5 is not published.
"""

from __future__ import annotations

from drivebus.protocols.sifang import Response
from drivebus.sim.memory import Cell, Guard, Refusal
from drivebus.sim.motor import Trip

FREQUENCY_CHANNEL = 0x0_01
FROM_BUS = 2
START_MODE = 0x4_00
SPEED_SEARCH = 1
INPUT_CHARACTERISTIC = 0x1_0A
MONITOR_SELECTOR = 0x6_0C
COMM_LOSS_ACTION, COMM_LOSS_TIME = 0x9_03, 0x9_04
COMM_LOSS_CONTINUE, COMM_LOSS_STOP, COMM_LOSS_TRIP = 0, 1, 2
"""Values of F9.3: the sim's own. F9.4 is in 0.1 s, 0 switches the timer off."""

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

_RESERVED = Cell(guard=Guard.HIDDEN)
_GROUP_SIZE = 32


def cells(step_hz: float, selector: int, comm_loss_time: int) -> dict[int, Cell]:
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
        COMM_LOSS_ACTION: Cell(COMM_LOSS_STOP, 0, 2),
        comm_loss_time: Cell(0, 0, 6000),
    }
    return table
