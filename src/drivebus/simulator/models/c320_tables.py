"""Parameters, faults and refusals of the pretend C320. Data only.

Named by appendix one: F0.1 (2 = RS485), F4.0 (1 = speed search), F1.10, F6.12, F9.3, F9.4. All other places, all
scales of times and the fault numbers are the sim's own: chapter 5 is not published.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.protocols.sunfar import SunfarResponse
from drivebus.simulator.motor import Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec, RejectReason

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

RESPONSES_BY_REASON = {
    RejectReason.UNKNOWN: SunfarResponse.BAD_CODE,
    RejectReason.HIDDEN: SunfarResponse.RESERVED,
    RejectReason.READ_ONLY: SunfarResponse.RESERVED,
    RejectReason.PASSWORD: SunfarResponse.PASSWORD,
    RejectReason.RUNNING: SunfarResponse.RUNNING,
    RejectReason.RANGE: SunfarResponse.OUT_OF_RANGE,
}
"""2.4.5."""

FAULT_CODES = {trip: number for number, trip in enumerate(Trip, start=1)}


@dataclass(frozen=True, slots=True)
class CommLossSettings:
    """Where a model keeps what it does when its host falls silent. The time is in 0.1 s; 0 switches the timer off."""

    time: int
    action: ParameterSpec
    place: int
    """Of the action."""
    stops: frozenset[int]
    trips: frozenset[int] = frozenset()


COMM_LOSS_F9 = CommLossSettings(0x9_04, ParameterSpec(1, 0, 2), 0x9_03, stops=frozenset({1}), trips=frozenset({2}))
"""C320: the values of F9.3 are the sim's own."""
COMM_LOSS_F4 = CommLossSettings(0x4_04, ParameterSpec(0, 0, 0x0011), 0x4_03, stops=frozenset({0x00, 0x01}))
"""E300 (F4.3, F4.4) and E550: the tens digit is 0 stop, 1 keep running. That a digit is four bits is the sim's own."""

_RESERVED = ParameterSpec(access=Access.HIDDEN)
_GROUP_SIZE = 32


def parameter_specs(step_hz: float, selector: int, comm_loss: CommLossSettings) -> dict[int, ParameterSpec]:
    """All sixteen groups; a place that nobody described is reserved. Commissioned: everything from RS485."""
    highest = round(400.0 / step_hz)
    table = {group << 8 | item: _RESERVED for group in range(16) for item in range(_GROUP_SIZE)}
    table |= {
        FREQUENCY_CHANNEL: ParameterSpec(FROM_BUS, 0, 9, Access.LOCKED_WHILE_RUNNING),
        KEYPAD_HZ: ParameterSpec(round(50.0 / step_hz), 0, highest),
        COMMAND_CHANNEL: ParameterSpec(FROM_BUS, 0, 2, Access.LOCKED_WHILE_RUNNING),
        MAXIMUM_HZ: ParameterSpec(round(50.0 / step_hz), round(5.0 / step_hz), highest, Access.LOCKED_WHILE_RUNNING),
        ACCEL_TIME: ParameterSpec(100, 1, 60000),
        DECEL_TIME: ParameterSpec(100, 1, 60000),
        JOG_HZ: ParameterSpec(round(5.0 / step_hz), 0, round(50.0 / step_hz)),
        INPUT_CHARACTERISTIC: ParameterSpec(0, 0, 0x1111),
        START_MODE: ParameterSpec(0, 0, 2, Access.LOCKED_WHILE_RUNNING),
        selector: ParameterSpec(0, 0, LAST_MONITOR),
        comm_loss.place: comm_loss.action,
        comm_loss.time: ParameterSpec(0, 0, 6000),
    }
    return table
