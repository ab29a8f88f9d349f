"""Drives with the state chart of PROFIdrive, which ABB's and Siemens' control words share: written from their manuals.

Chart: ACS355 manual page 319, ACH550-UH manual page 163; SINAMICS G120C manual pages 194, 195 and 235. Bits 0 to 7
and 10 of the control word and 0 to 6 of the status word mean the same in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from drivebus.simulator.motor import Motor, Trip
from verification.source_stations.readings import NUMBERED_TRIPS, amperes, bus_volts, fault, hertz, rpm, volts
from verification.source_stations.station import SourceDrive, SourceStation

ON, NO_COAST, NO_QUICK_STOP, OPERATION, RESET, BUS_CONTROL, INVERT = 1, 2, 4, 8, 0x80, 0x400, 0x800
RAMP_BITS = 0x70  # output, acceleration and input of the ramp generator: all are needed to follow the setpoint
UNREAD_MAXIMUM_HZ = 50.0  # maximum frequency of a drive that gives no register of it


class ChartState(Enum):
    """State of the chart, by ABB's names."""

    INHIBITED = "switch-on inhibited"
    READY_TO_SWITCH_ON = "ready to switch on"
    READY_TO_OPERATE = "ready to operate"
    ENABLED = "operation enabled"
    OFF1 = "OFF1 active"
    OFF2 = "OFF2 active"
    OFF3 = "OFF3 active"


@dataclass(frozen=True, kw_only=True)
class ChartDrive(SourceDrive):
    """Registers and scale of a drive with the state chart."""

    control_register: int
    full_scale: int
    """Setpoint that means the maximum frequency."""


class ChartStation(SourceStation):
    """Simulated drive of a ``ChartDrive``. ``shows_ramp``: operation stays enabled until standstill after OFF1.

    The manuals leave open whether it does.
    """

    drive: ChartDrive

    def __init__(self, address: int, drive: ChartDrive, *, shows_ramp: bool, motor: Motor | None = None) -> None:
        super().__init__(address, drive, motor=motor)
        self.drive, self.shows_ramp = drive, shows_ramp
        self.power_up()

    def power_up(self) -> None:
        super().power_up()
        self.state, self.control_word = ChartState.INHIBITED, 0

    @property
    def set_hz(self) -> float:
        """Set frequency in Hz: a signed share of the maximum, which bit 11 inverts."""
        word = self.setpoint_word - (self.setpoint_word & 0x8000) * 2
        maximum_hz = UNREAD_MAXIMUM_HZ
        if self.drive.maximum is not None:
            register, _, step_hz = self.drive.maximum
            maximum_hz = self.memory[register] * step_hz
        return word * maximum_hz / self.drive.full_scale * (-1 if self.control_word & INVERT else 1)

    @property
    def status_word(self) -> int:
        self._settle()
        if self.tripped:
            return 0x0238  # fault, OFF2 and OFF3 inactive, control by the bus
        enabled = self.state is ChartState.ENABLED or (
            self.shows_ramp and self.state in (ChartState.OFF1, ChartState.OFF3) and self.motor.energised
        )
        bits = {
            0: self.state not in (ChartState.INHIBITED, ChartState.OFF2, ChartState.OFF3),
            1: self.state in (ChartState.READY_TO_OPERATE, ChartState.ENABLED),
            2: enabled,
            4: bool(self.control_word & NO_COAST),
            5: bool(self.control_word & NO_QUICK_STOP),
            6: self.state is ChartState.INHIBITED,
            9: True,
            12: True,  # ABB: external run enable
        }
        return sum(1 << bit for bit, is_set in bits.items() if is_set)

    def _settle(self) -> None:
        """Leave the states that last until standstill, and those that a trip ends."""
        if self.tripped:
            self.state = ChartState.INHIBITED
        elif not self.motor.energised and self.state is ChartState.OFF1:
            self.state = ChartState.READY_TO_SWITCH_ON
        elif not self.motor.energised and self.state in (ChartState.OFF2, ChartState.OFF3):
            self.state = ChartState.INHIBITED

    def _store(self, register: int, value: int) -> int:
        if register != self.drive.control_register:
            return super()._store(register, value)
        if value & BUS_CONTROL:  # without it the word is ignored
            self._settle()
            before, self.control_word = self.control_word, value
            self._follow(before, value)
        return 0

    def _follow(self, before: int, word: int) -> None:
        if self.tripped:
            if word & RESET and not before & RESET:
                self.motor.reset()
        elif not word & NO_COAST:
            self.motor.coast()
            self.state = ChartState.OFF2
        elif not word & OPERATION and self.motor.energised:
            self._operate(enabled=False, follows=False)
        elif not word & NO_QUICK_STOP:
            self.motor.stop(min(1.0, self.motor.decel_s))
            self.state = ChartState.OFF3
        elif not word & ON:
            self._switch_off()
        elif self.state is ChartState.READY_TO_SWITCH_ON and not before & ON:
            self.state = ChartState.READY_TO_OPERATE
        if self.state in (ChartState.READY_TO_OPERATE, ChartState.ENABLED):
            self._operate(enabled=bool(word & OPERATION), follows=word & RAMP_BITS == RAMP_BITS)

    def _switch_off(self) -> None:
        """OFF1: ramp down from operation; where nothing turns, a drive that was inhibited becomes ready."""
        if self.motor.energised:
            self.motor.stop()
            self.state = ChartState.OFF1
        else:
            self.state = ChartState.READY_TO_SWITCH_ON

    def _operate(self, *, enabled: bool, follows: bool) -> None:
        if enabled:
            self.state = ChartState.ENABLED
            self.run_towards(self.set_hz if follows else 0.0)
        elif self.motor.energised:
            self.motor.coast()
            self.state = ChartState.READY_TO_OPERATE


def chart_status(station: SourceStation) -> float:
    assert isinstance(station, ChartStation)
    return station.status_word


ACS550 = ChartDrive(
    model="acs550",
    source="ABB ACS355 manual pages 313 and 319 (easymanua.ls/abb/acs355/manual?p=313), ACS550-02 manual pages 223 to "
    "228 (easymanua.ls/abb/acs550-02/manual?p=218); scales of eriknyquist/modbus, abb_ach550_1.conf, commit 9e6e6f1",
    line="9600 8N2",  # ACS550-01 page 151
    functions=(3, 6, 16),
    commands={},
    control_register=0,  # 40001
    setpoint_register=1,  # 40002
    full_scale=20000,
    maximum=(1104, 500, 0.1),  # 1105 = 50.0 Hz
    settings={
        1000: 10,  # 1001: commands from the bus
        1002: 1,  # 1003: forward
        1102: 8,  # 1103: reference from the bus
        2201: 100,  # 2202: 10.0 s, ACH550-UH manual page 1-121
        2202: 100,  # 2203
        3017: 1,  # 3018
        3018: 30,  # 3019
        5301: 3,  # 5302: address, Daikin ACS320 manual page 68
        5303: 1,  # 5304: 8N2
        5304: 0,  # 5305
        9903: 3,  # 9904: frequency control
    },
    readings={
        3: chart_status,
        101: rpm,  # 40102
        102: hertz(0.1),  # 40103
        103: amperes(0.1),  # 40104
        104: lambda station: 0,  # 40105, torque
        105: lambda station: max(0.0, station.displayed_motor.power_kw) * 10,  # 40106
        106: bus_volts(1.0),  # 40107
        108: volts(1.0),  # 40109
        400: fault,  # 40401
    },
    faults={**NUMBERED_TRIPS, Trip.OVERLOAD: 9},  # ACS550-02 page 259: motor overtemperature
)
V20 = ChartDrive(
    model="v20",
    source="SINAMICS V20 manual 07/2012 page 112 (easymanua.ls/siemens/sinamics-v20-series/manual?p=112); "
    "bdring/FluidNC, FluidNC/src/Spindles/VFD/SiemensV20Protocol.cpp, commit 109950d; bits of the G120C",
    line="9600 8E1",
    functions=(3, 6, 16),
    commands={},
    control_register=99,  # 40100
    setpoint_register=100,  # 40101
    full_scale=16384,
    maximum=(15, 5000, 0.01),  # 40016 = 50.00 Hz
    settings={10: 1000, 11: 1000},  # 40011, 40012
    readings={
        109: chart_status,
        23: hertz(0.01),  # 40024
        24: rpm,  # 40025
        25: amperes(0.01),  # 40026
        26: lambda station: 0,  # 40027, torque
        27: lambda station: max(0.0, station.displayed_motor.power_kw) * 100,  # 40028
        28: lambda station: 0,  # 40029, energy
        29: bus_volts(1.0),  # 40030
    },
    faults=NUMBERED_TRIPS,
)
G120C = ChartDrive(
    model="g120c",
    source="SINAMICS G120C manual pages 194, 195 (manualshive.com/en/manual/siemens/sinamics-g120c/376473?page=194), "
    "03/2012 page 130 (manualslib.com/manual/3390425); G120X manual page 250 (manualshive.com, sinamics-g120x/381564)",
    line="19200 8E1",
    functions=(3, 6, 16),
    commands={},
    control_register=99,
    setpoint_register=100,
    full_scale=16384,
    settings={321: 1000, 322: 1000, 323: 1500},  # 40322, 40323, 40324
    readings={
        109: chart_status,
        339: lambda station: 0,  # 40340, speed setpoint
        340: rpm,  # 40341
        341: hertz(0.01),  # 40342
        342: volts(1.0),  # 40343
        343: bus_volts(1.0),  # 40344
    },
    faults=NUMBERED_TRIPS,
)
CHART_DRIVES = {drive.model: drive for drive in (ACS550, V20, G120C)}
"""Every drive with the state chart."""
