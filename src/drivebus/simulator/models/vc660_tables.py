"""Registers, bits and parameters of the pretend VC660. Data only.

From the debugging guide; sizes of the parameter groups, places beyond F00.00-F00.03 and fault bits beyond b0 are the
sim's own: the guide does not print them.
"""

from __future__ import annotations

from drivebus.simulator.nameplate import Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec

PARAMETERS = 451
"""Indices 0-450 (0-1C2H)."""
SAVE_BIT = 0x8000
"""Index with this bit: EEPROM as well (T14)."""
MAX_READ = 4
GROUP_SIZES = (30, 40, 60, 60, 50, 60, 20, 50, 40, 41)
"""Parameters of F00, F01, … The guide does not publish them: the sim's own, 451 in all."""

START, STOP, REVERSE, JOG_FORWARD, JOG_REVERSE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 4
COAST, EMERGENCY, PAUSE, HOLD, RESET = 1 << 5, 1 << 6, 1 << 7, 1 << 8, 1 << 9
PULSE_BITS = START | STOP | COAST | EMERGENCY | RESET
"""Marked * in the control table."""

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, FAILED = 1, 2, 3, 4

FAULT_BITS = {Trip.UNDERVOLTAGE: 0} | {
    trip: 1 + n for n, trip in enumerate(t for t in Trip if t is not Trip.UNDERVOLTAGE)
}
"""b0 of the first fault word is under-voltage; the others are the sim's own."""
ANALOG_LIMIT = 0x3FFF
"""The guide prints "0~3ffff", which no register holds [OPEN]."""


def parameter_index(group: int, number: int) -> int:
    """The consecutive index of Fgg.nn."""
    return sum(GROUP_SIZES[:group]) + number


FREQUENCY_SOURCE, KEYPAD_HZ = parameter_index(0, 1), parameter_index(0, 2)
COMMAND_SOURCE = parameter_index(1, 0)
REPLY_DELAY, VIRTUAL_INPUTS = parameter_index(6, 6), parameter_index(6, 7)
FIRST_OUTPUT, HOST_OUTPUT = parameter_index(4, 0), 28
ACCEL_TIME, DECEL_TIME, JOG_HZ = parameter_index(0, 8), parameter_index(0, 9), parameter_index(0, 10)
"""The sim's own places; 0.1 s and 0.01 Hz."""


def parameter_specs() -> dict[int, ParameterSpec]:
    """The parameters as a commissioned drive has them: commands and frequency from the bus."""
    table = {number: ParameterSpec() for number in range(PARAMETERS)}
    table |= {
        parameter_index(0, 0): ParameterSpec(5000, 0, 40000, Access.LOCKED_WHILE_RUNNING),
        FREQUENCY_SOURCE: ParameterSpec(4, 0, 9, Access.LOCKED_WHILE_RUNNING),
        KEYPAD_HZ: ParameterSpec(5000, 0, 40000),
        parameter_index(0, 3): ParameterSpec(0, 0, 40000),
        ACCEL_TIME: ParameterSpec(100, 1, 36000),
        DECEL_TIME: ParameterSpec(100, 1, 36000),
        JOG_HZ: ParameterSpec(500, 0, 40000),
        COMMAND_SOURCE: ParameterSpec(2, 0, 2, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 2): ParameterSpec(0, 0, 1, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 3): ParameterSpec(1, 0, 247, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 4): ParameterSpec(5, 0, 7, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 5): ParameterSpec(0, 0, 2, Access.LOCKED_WHILE_RUNNING),
        REPLY_DELAY: ParameterSpec(4, 0, 1000),
        VIRTUAL_INPUTS: ParameterSpec(0, 0, 1),
    }
    return table
