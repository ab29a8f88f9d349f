"""Tables of the source stations: each register and word with the page or the line of code that gives it.

A page of a manual is the page printed on it. No entry was copied from a profile; ``faults`` number the simulator's
trips by the source's list of faults, and by numbers within its range where it gives no list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from drivebus.simulator.motor import Trip
from verification.source_stations.readings import (
    NUMBERED_TRIPS,
    amperes,
    bus_volts,
    celsius,
    fault,
    hertz,
    rpm,
    set_hertz,
    volts,
)
from verification.source_stations.station import SourceDrive, SourceStation
from verification.source_stations.toshiba import VF_S15

# Sunfar E300 and E500.

SUNFAR_ACTIONS = {
    0x00: "",  # "invalid command"
    0x01: "forward",
    0x02: "reverse",
    0x03: "stop",
    0x04: "jog_forward",
    0x05: "jog_reverse",
    0x06: "stop",  # stops an inching run
    0x20: "reset",
}
"""E500 manual page 89; 1, 2, 3 and 20H also in bbctrl-firmware, sunfar_e300_regs."""


def sunfar_state(station: SourceStation) -> int:
    """Return register 2000H: E500 manual pages 89 and 90, E300 manual page 58."""
    if station.tripped:
        return 0x20
    if not station.running:
        return 0x03
    if station.jogging:
        return station.either(0x04, 0x05)
    if station.motor.stopping or station.decelerating:
        return station.either(0x14, 0x15)
    if station.accelerating:
        return station.either(0x11, 0x12)
    return station.either(0x01, 0x02)


SUNFAR_READINGS: Mapping[int, Callable[[SourceStation], float]] = {
    0x2000: sunfar_state,  # E500 page 89; bbctrl-firmware reads it as the status
    0x2001: fault,  # E500 page 89: fault message; note (4): high byte 0, low byte the number behind "Fu."
    0xD000: hertz(0.1),  # E300 page 59, E500 page 91: 01F4H is 50.0 Hz
    0xD001: amperes(0.1),  # E300 page 59: 000BH is 1.1 A
}
E500 = SourceDrive(
    model="e500_modbus",
    source="Sunfar E500 manual pages 89 to 91 (easymanua.ls/sunfar/e500-2s0015-b, p=99 to 101)",
    functions=(3, 6, 16),
    commands={0x1001: SUNFAR_ACTIONS.get},
    setpoint_register=0x1002,
    setpoint_step_hz=0.1,  # page 90, example 2: 01F4H is 50.0 Hz
    readings=SUNFAR_READINGS,
    faults=NUMBERED_TRIPS,
)
E300 = SourceDrive(
    model="e300_modbus",
    source="Sunfar E300 manual pages 58 and 59 (easymanua.ls/sunfar/e300-2s0022-b, p=65, 66); commands 1, 2, 3, 20H "
    "of buildbotics/bbctrl-firmware, src/avr/src/vfd_spindle.c, sunfar_e300_regs, commit e41ae00; E500 manual page 89",
    functions=(3, 6, 16),
    commands={0x1001: SUNFAR_ACTIONS.get},
    setpoint_register=0x1002,
    setpoint_step_hz=0.1,  # page 59, example 2
    readings=SUNFAR_READINGS,
    faults=NUMBERED_TRIPS,
)

# ENC EDS300 and EDS1300.

ENC_ACTIONS = {
    2: "stop",  # stops an inching run
    3: "jog_forward",
    4: "jog_reverse",
    6: "stop",
    7: "forward",
    8: "reverse",
    9: "reset",
    10: "quick_stop",
}
"""EDS300 manual page 40, EDS1300 manual page 131; 1 and 5 run in the direction that the drive is set to."""


def enc_state(station: SourceStation) -> int:
    """Return register 2100H: 1 forward, 2 reverse, 3 stopped, 4 alarm (EDS300 page 40, EDS1300 page 131)."""
    if station.tripped:
        return 4
    return station.either(1, 2) if station.running else 3


ENC_READINGS: Mapping[int, Callable[[SourceStation], float]] = {
    0x2100: enc_state,
    0x2180: fault,  # 1 to 23 for E001 to E023
    0x1000: set_hertz(0.01),  # C-00
    0x1001: hertz(0.01),  # C-01
    0x1002: amperes(0.1),  # C-02
    0x1003: volts(1.0),  # C-03
    0x1004: bus_volts(1.0),  # C-04
    0x1005: rpm,  # C-05
    0x1006: celsius,  # C-06
}
EDS300 = SourceDrive(
    model="eds300",
    source="ENC EDS300 manual pages 40 to 42 (manualshive.com/ru/manual/enc/eds300-series/2405767, pages 44 to 46)",
    commands={0x2000: ENC_ACTIONS.get},
    setpoint_register=0x2001,
    setpoint_step_hz=0.01,  # 7.7.3: 1388H is 50 Hz
    readings=ENC_READINGS,
    faults=NUMBERED_TRIPS,
)
EDS1300 = SourceDrive(
    model="eds1300",
    source="ENC EDS1300 service manual pages 131 to 133 (manualshelf.com, service-manual-english, page 140)",
    commands={0x2000: ENC_ACTIONS.get},
    setpoint_register=0x2001,
    setpoint_step_hz=0.01,  # 11.7.3: 1388H is 50 Hz
    readings=ENC_READINGS,
    faults=NUMBERED_TRIPS,
)

# Eaton DC1.


def dc1_action(word: int) -> str | None:
    """Return the action of register 1: bits 0 run, 1 reverse, 2 reset, 3 coast, 5 quick stop (page 143)."""
    if word & ~0x2F:
        return None
    if word & 0x08:
        return "coast"
    if word & 0x04:
        return "reset"
    if word & 0x20:
        return "quick_stop"
    return ("reverse" if word & 0x02 else "forward") if word & 0x01 else "stop"


def dc1_state(station: SourceStation) -> int:
    """Return register 6: ready, run, reverse, fault; the fault in the high byte (pages 144 and 145)."""
    low = (not station.tripped) | station.running << 1 | station.rotates_reverse << 2 | station.tripped << 3
    return int(low) | station.fault << 8


DC1 = SourceDrive(
    model="dc1",
    source="Eaton DC1 manual MN04020003Z-EN, 12/13, pages 143 to 148 (easymanua.ls/eaton/powerxl-dc1-series, p=149 to "
    "154): register numbers from 1, one less on the wire (page 148)",
    line="115200 8N1",
    commands={0: dc1_action},
    setpoint_register=1,
    setpoint_step_hz=0.1,  # page 143
    readings={
        5: dc1_state,
        6: hertz(0.1),  # page 144, register 7
        7: amperes(0.1),  # register 8; page 145: 34 is 3.4 A
        22: bus_volts(1.0),  # register 23
        23: celsius,  # register 24
    },
    faults=NUMBERED_TRIPS,
)

# Allen-Bradley PowerFlex 4M.


def powerflex_action(word: int) -> str | None:
    """Return the action of 8192: bits 0 stop, 1 start, 2 jog, 3 clear faults, 4 forward, 5 reverse (page C-4)."""
    if word & ~0x3F:
        return None
    if word & 0x01:
        return "stop"
    if word & 0x08:
        return "reset"
    direction = {0x10: "forward", 0x20: "reverse"}.get(word & 0x30)
    if direction is None:
        return None
    return direction if word & 0x02 else f"jog_{direction}" if word & 0x04 else ""


def powerflex_state(station: SourceStation) -> int:
    """Return 8448: bits of page C-5; reference and commands come from the port (bits 9 and 10)."""
    bits = (
        not station.tripped,
        station.running,
        not station.reverse,
        not station.rotates_reverse,
        station.accelerating,
        station.decelerating,
        False,
        station.tripped,
        station.running and not station.accelerating and not station.decelerating,
        True,
        True,
    )
    return sum(1 << bit for bit, on in enumerate(bits) if on)


POWERFLEX_4M = SourceDrive(
    model="powerflex_4m",
    source="PowerFlex 4M user manual 22F-UM001D pages C-4 to C-6 (azmanual.top/manuals/576950, page 104; easymanua.ls/"
    "allen-bradley/powerflex-4m, p=105, 106); brettmcalpine/PowerFlex4m, src/PowerFlex4m.h, commit 0ddd390",
    functions=(3, 6, 16),
    commands={8192: powerflex_action},
    setpoint_register=8193,
    setpoint_step_hz=0.1,  # page C-5: 543 is 54.3 Hz; PowerFlex4m.cpp writes Hz * 10
    readings={
        8448: powerflex_state,
        8449: fault,
        8451: hertz(0.1),  # page C-6: 123 is 12.3 Hz
    },
    faults={
        Trip.OVERCURRENT_ACCELERATING: 12,  # page C-6, and the same numbers in PowerFlex4m.h
        Trip.OVERCURRENT_DECELERATING: 12,
        Trip.OVERCURRENT_RUNNING: 63,
        Trip.OVERVOLTAGE: 5,
        Trip.UNDERVOLTAGE: 4,
        Trip.OVERLOAD: 7,
        Trip.OVERHEAT: 8,
        Trip.EXTERNAL: 2,
        Trip.COMM_LOSS: 81,
        Trip.OTHER: 70,
    },
)

# Delta MS300.

DELTA_ACTIONS = {0x01: "stop", 0x12: "forward", 0x22: "reverse"}
"""FluidNC DeltaMS300.cpp; the same words in bbctrl-firmware, delta_regs, and as bits in LinuxCNC vfdb_vfd.c."""


def delta_state(station: SourceStation) -> int:
    """Return 2101H: bits 1-0 stopped, stopping, standby, running; bits 4-3 direction, 11 reverse (page 790)."""
    run = 0b01 if station.running and station.motor.stopping else 0b11 if station.running else 0b00
    commanded, turning = station.reverse, station.rotates_reverse
    direction = (0b11 if turning else 0b10) if commanded else (0b01 if turning else 0b00)
    return run | direction << 3


MS300 = SourceDrive(
    model="ms300",
    source="Delta MS300 manual pages 786 to 790 (easymanua.ls/delta/vfd2a8ms21ansaa, p=798, 799); bdring/FluidNC, "
    "FluidNC/src/Spindles/VFD/DeltaMS300.cpp, commit e952f33; bbctrl-firmware, delta_regs, commit e41ae00",
    line="9600 7N2",
    is_ascii=True,
    functions=(3, 6, 16),
    commands={0x2000: DELTA_ACTIONS.get, 0x2002: {0x02: "reset"}.get},  # 2002H: page 789; bbctrl-firmware writes 2
    setpoint_register=0x2001,
    setpoint_step_hz=0.01,  # page 789; FluidNC writes rpm * 100 / 60
    settings={0x010C: 1000, 0x010D: 1000},  # GS10 manual page 4-69: 10.00 s; addresses: MH300 manual page A-9
    readings={
        0x2100: fault,  # page 790: low byte the fault, high byte a warning
        0x2101: delta_state,
        0x2102: set_hertz(0.01),
        0x2103: hertz(0.01),  # and FluidNC, bbctrl-firmware
        0x2104: amperes(0.01),
        0x2105: bus_volts(0.1),
        0x2106: volts(0.1),
    },
    faults=NUMBERED_TRIPS,
)

# LS M100.


def ls_action(word: int) -> str | None:
    """Return the action of 0006: bits 0 stop, 1 forward, 2 reverse, 3 reset (SV-ActionMaster page 81)."""
    return {1: "stop", 2: "forward", 4: "reverse", 8: "reset"}.get(word)


def ls_state(station: SourceStation) -> int:
    """Return 000E as a real M100 answers it (RPi-Modbus-VFD, stat_display.py); a trip is bit 3 (page 81)."""
    if station.tripped:
        return 0x6009
    if not station.running:
        return 24577
    if station.motor.stopping:
        return station.either(24866, 24868)
    if station.accelerating:
        return station.either(26642, 28692)
    if station.decelerating:
        return station.either(26658, 28708)
    return station.either(26690, 28740)


LS_M100 = SourceDrive(
    model="ls_m100",
    source="LS SV-ActionMaster manual page 81 (lawnandgarden.manualsonline.com, Cleveland Range inverter, page 87); "
    "The-Intrigued-Engineer/RPi-Modbus-VFD, stat_display.py and user_inputs.py, commit 6469bf3: one less on the wire",
    functions=(3, 6, 16),
    commands={5: ls_action},
    setpoint_register=4,
    setpoint_step_hz=0.01,
    readings={
        8: amperes(0.1),
        9: hertz(0.01),
        10: volts(1.0),
        11: bus_volts(1.0),
        12: lambda station: max(0.0, station.displayed_motor.power_kw) / 0.1,
        13: ls_state,
        14: lambda station: 1 << station.fault if station.tripped else 0,
    },
    faults={
        Trip.OVERCURRENT_ACCELERATING: 0,  # page 81: OC, OV, EXT, BX, LV, fuse, GF, OH from bit 0
        Trip.OVERCURRENT_DECELERATING: 0,
        Trip.OVERCURRENT_RUNNING: 0,
        Trip.OVERVOLTAGE: 1,
        Trip.UNDERVOLTAGE: 4,
        Trip.OVERLOAD: 7,
        Trip.OVERHEAT: 7,
        Trip.EXTERNAL: 2,
        Trip.COMM_LOSS: 3,
        Trip.OTHER: 6,
    },
)

# Fuling DZB200 and INVT Goodrive10.

INVT_ACTIONS = {
    1: "forward",
    2: "reverse",
    3: "jog_forward",
    4: "jog_reverse",
    5: "stop",
    6: "coast",
    7: "reset",
    8: "stop",  # stops a jog
}
"""Goodrive10 manual page 87; FULING_DZB_CMD_CONTROL of the Pico program; 1, 2 and 5 in bbctrl-firmware."""


def invt_state(station: SourceStation) -> int:
    """Return the state: 1 forward, 2 reverse, 3 stopped, 4 fault (Pico program; Goodrive10 page 87)."""
    if station.tripped:
        return 4
    return station.either(1, 2) if station.running else 3


DZB200 = SourceDrive(
    model="dzb200",
    source="Fuling DZB200 manual page 95 (cncu.co.za, page 51); bbctrl-firmware, fuling_dzb200_regs, commit e41ae00; a "
    "Raspberry Pi Pico program with FULING_DZB_CMD_CONTROL and FULING_DZB_CMD_STATE",
    commands={0x1000: INVT_ACTIONS.get},  # both programs
    setpoint_register=0x2000,
    maximum=(0x0004, 5000, 0.01),  # page 95: share of P0.04; bbctrl-firmware reads it at 0004H in the unit of 3001H
    readings={
        0x1001: invt_state,  # Pico program
        0x3000: set_hertz(0.01),  # page 95 and from here both
        0x3001: hertz(0.01),
        0x3002: amperes(0.1),
        0x3003: volts(1.0),
        0x3004: rpm,
        0x3007: bus_volts(0.1),
        0x5000: fault,
    },
    faults=NUMBERED_TRIPS,
)
GD10 = SourceDrive(
    model="gd10",
    source="INVT Goodrive10 manual pages 87 and 93 (manualshive.com, universal-motors/goodrive-10/1058543); "
    "gabonator/LA104, system/apps/73_invt/invtgd10.h, commit a7b42e6; decimals: Goodrive200L manual page 153",
    line="19200 8E1",
    functions=(3, 6, 16),
    commands={0x2000: INVT_ACTIONS.get},
    setpoint_register=0x2001,
    setpoint_step_hz=0.01,  # page 87
    settings={  # factory settings of the Goodrive200A manual, pages 34 to 38 and 93, but the two sources: the bus
        0x0000: 2,
        0x0001: 2,
        0x0003: 5000,
        0x0004: 5000,
        0x0006: 8,
        0x000A: 5000,
        0x000B: 100,
        0x000C: 100,
        0x000D: 0,
        0x0E04: 0,
        0x0E05: 0,
    },
    readings={
        0x2100: invt_state,
        0x2102: fault,
        0x2103: lambda station: 0x010D,  # invtgd10.h: GD10mini
        0x3000: hertz(0.01),
        0x3001: set_hertz(0.01),
        0x3002: bus_volts(1.0),
        0x3003: volts(1.0),
        0x3004: amperes(0.1),
        0x3005: rpm,
    },
    faults=NUMBERED_TRIPS,
)

# Yalang YL600 and YL620-A.

YALANG_ACTIONS = {0x01: "stop", 0x12: "forward", 0x22: "reverse", 0x80: "reset"}
"""FluidNC YL620.cpp, grblHAL yl620.c (bits 1-0, 5-4, 7-6) and bbctrl-firmware, yl600_regs; YL600 manual page 27."""
YALANG_READINGS: Mapping[int, Callable[[SourceStation], float]] = {
    0x2008: fault,  # YL600 manual page 27: error code; bbctrl-firmware reads it as the status
    0x2009: lambda station: station.running,  # internal state, whose values no source gives
    0x200A: set_hertz(0.1),  # grblHAL yl620.c: target frequency
    0x200B: hertz(0.1),  # FluidNC and grblHAL; bbctrl-firmware
    0x200C: amperes(0.1),  # grblHAL yl620.c, without a step
}
YL600 = SourceDrive(
    model="yl600",
    source="Yalang YL600 manual page 27 (manualshive.com/en/manual/ya-lang/yl600-1-5kw-220v/3074792); "
    "bbctrl-firmware, yl600_regs, commit e41ae00",
    commands={0x2000: YALANG_ACTIONS.get},
    setpoint_register=0x2001,
    setpoint_step_hz=0.1,  # page 27
    readings=YALANG_READINGS,
    faults=NUMBERED_TRIPS,
)
YL620 = SourceDrive(
    model="yl620",
    source="bdring/FluidNC, FluidNC/src/Spindles/VFD/YL620.cpp, commit e952f33; grblHAL/Plugins_spindle, vfd/yl620.c, "
    "commit 9581591",
    commands={0x2000: YALANG_ACTIONS.get},
    setpoint_register=0x2001,
    setpoint_step_hz=0.1,  # both: rpm * 10 / rpm per Hz
    readings=YALANG_READINGS,
    faults=NUMBERED_TRIPS,
)

ALL_DRIVES = (E300, E500, EDS300, EDS1300, DC1, POWERFLEX_4M, MS300, LS_M100, DZB200, GD10, YL600, YL620, VF_S15)
SOURCE_DRIVES = {drive.model: drive for drive in ALL_DRIVES}
"""Every drive that was written from its source."""
