"""Station of the Toshiba VF-S15 from its RS485 manual E6581913; the pages are those printed on it."""

from __future__ import annotations

from drivebus.simulator.motor import Trip
from verification.source_stations.readings import fault, hertz, set_hertz
from verification.source_stations.station import SourceDrive, SourceStation


def toshiba_action(word: int) -> str | None:
    """Return what FA00H does (page 52): bit 13 resets, 12 stops at once (not simulated), 11 coasts, 10 runs, 9 reverse.

    All but these two need the command priority, bit 15, and the frequency FA01H its own, bit 14.
    """
    if word & 0x2000:
        return "reset"
    if word & 0x1FFF & ~0x0E00 or (word & 0x0400 and not word & 0x4000):
        return None
    if not word & 0x8000:
        return ""
    if word & 0x0800:
        return "coast"
    return ("reverse" if word & 0x0200 else "forward") if word & 0x0400 else "stop"


def toshiba_state(station: SourceStation) -> int:
    """Return FD01H (page 59): bit 10 run, 9 reverse, 1 tripped, 0 its relay, 13 and 14 standby, 15 undefined.

    The page does not say whether bit 10 lasts until the motor stands; here it falls at the stop. E404H of the frame on
    page 28 has bit 15, and an alarm, bit 2.
    """
    if station.tripped:
        return 0x0003  # page 23: "stop status, FL output status, trip status"
    run = station.running and not station.motor.stopping
    return 0xE000 | run << 10 | station.rotates_reverse << 9


VF_S15 = SourceDrive(
    model="vf_s15",
    source="Toshiba RS485 manual E6581913 (sina1988/VF-S15-Inverter-Control, docs/S15_RS485_Communication_Manual.pdf, "
    "commit b5b39b4)",
    line="19200 8E1",  # pages 4 and 47
    max_read=8,  # page 29; page 26 gives 1
    commands={0xFA00: toshiba_action},
    unanswered=frozenset({"reset"}),  # page 52
    setpoint_register=0xFA01,
    setpoint_step_hz=0.01,  # page 54
    settings={0x0803: 0, 0x0804: 0, 0xFB07: 224},  # pages 47 and 70
    readings={
        0xFD00: hertz(0.01),  # this and the others: page 70
        0xFD01: toshiba_state,
        0xFD02: set_hertz(0.01),
        0xFD03: lambda station: station.displayed_motor.current_a / station.motor.rating.current_a * 10000.0,
        0xFD30: lambda station: max(0.0, station.displayed_motor.power_kw) / 0.01,
        0xFC90: fault,
    },
    faults={  # page 63; 17 is the emergency stop, 22 a fault of the main unit
        Trip.OVERCURRENT_ACCELERATING: 1,
        Trip.OVERCURRENT_DECELERATING: 2,
        Trip.OVERCURRENT_RUNNING: 3,
        Trip.OVERVOLTAGE: 12,
        Trip.UNDERVOLTAGE: 30,
        Trip.OVERLOAD: 13,
        Trip.OVERHEAT: 16,
        Trip.EXTERNAL: 17,
        Trip.COMM_LOSS: 24,
        Trip.OTHER: 22,
    },
)
