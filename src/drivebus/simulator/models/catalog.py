"""Which pretend drives there are, and the texts that name them: ``c320@0-3,7+vc660@8``. Values only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from drivebus.errors import ConfigurationError
from drivebus.simulator.models.c320 import C320Station
from drivebus.simulator.models.c320_tables import COMM_LOSS_F4
from drivebus.simulator.models.df800 import DF800Station
from drivebus.simulator.models.dzb100 import DZB100Station
from drivebus.simulator.models.vc660 import VC660Station
from drivebus.simulator.motor import Motor, MotorLoad
from drivebus.simulator.station import Station

_CODINGS = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")
_STATION_OPTIONS: Mapping[type[Station], tuple[range, Mapping[str, tuple[str, ...]]]] = {
    C320Station: (
        range(31),
        {
            "monitor_index": ("binary", "bcd"),
            "watchdog": ("own", "all"),
            "digits": ("strict", "tolerant"),
            "nibble": ("off", "on"),
            "class0_fault": ("code", "information"),
        },
    ),
    DZB100Station: (
        range(32),
        {
            "setpoint_coding": _CODINGS,
            "query_coding": _CODINGS,
            "parameter_coding": _CODINGS,
            "b_digit": ("06", "state"),
            "fault_coding": ("decimal", "hex"),
        },
    ),
    VC660Station: (range(248), {"pulses": ("edge", "write")}),
    DF800Station: (range(1, 248), {"encoding": ("rtu", "ascii"), "direction_field": ("b3b2", "b2b3")}),
}
"""Addresses, and settings with their values."""

MODELS: Mapping[str, tuple[type[Station], Mapping[str, Any]]] = {
    "c320": (C320Station, {}),
    "c300": (C320Station, {"current_at_1": True}),
    "e300": (C320Station, {"step_hz": 0.1, "current_at_1": True, "comm_loss": COMM_LOSS_F4}),
    "e500": (C320Station, {"step_hz": 0.1, "selector": 0x308}),
    "e550": (C320Station, {"step_hz": 0.1, "comm_loss": COMM_LOSS_F4}),
    "dzb100": (DZB100Station, {}),
    "vc660": (VC660Station, {}),
    "df800": (DF800Station, {}),
}

"""Their own manuals: E500 selects its monitor with F3.08; E300 and E550 keep F9.3 and F9.4 in F4.3 and F4.4."""

LOADS: Mapping[str, Callable[[], MotorLoad]] = {"constant": MotorLoad, "fan": MotorLoad.fan, "winch": MotorLoad.hoist}

STATION_OPTION_NAMES = frozenset(name for _, settings in _STATION_OPTIONS.values() for name in settings)


def make_station(
    model: str, address: int, settings: Mapping[str, str] | None = None, load: str = "constant"
) -> Station:
    """One drive. ``settings`` of other families are passed over. Raises ConfigurationError."""
    if model not in MODELS:
        raise ConfigurationError("sim.model", found=model, expected=", ".join(MODELS))
    family, fixed = MODELS[model]
    addresses, known = _STATION_OPTIONS[family]
    if address not in addresses:
        expected = f"{addresses.start} … {addresses.stop - 1}"
        raise ConfigurationError("sim.address", model=model, found=address, expected=expected)
    if load not in LOADS:
        raise ConfigurationError("sim.setting", name="load", found=load, expected=", ".join(LOADS))
    chosen = dict(fixed)
    for name, value in (settings or {}).items():
        if name in known:
            if value not in known[name]:
                raise ConfigurationError("sim.setting", name=name, found=value, expected=", ".join(known[name]))
            chosen[name] = value
    return family(address, motor=Motor(load=LOADS[load]()), **chosen)


def make_stations(text: str, settings: Mapping[str, str] | None = None, load: str = "constant") -> list[Station]:
    """Every drive of a text such as ``c320@0-3,7+vc660@8``. Raises ConfigurationError."""
    stations: list[Station] = []
    for part in text.split("+"):
        model, separator, addresses = part.partition("@")
        if not separator:
            raise ConfigurationError("sim.target", found=part, expected="MODEL@ADDRESSES, c320@0-3,7")
        stations += [make_station(model.lower(), address, settings, load) for address in parse_addresses(addresses)]
    return stations


def parse_addresses(text: str) -> list[int]:
    """``0-3,7`` → 0, 1, 2, 3, 7. Raises ConfigurationError."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or len(part) > 7:
            raise ConfigurationError("sim.addresses", found=text, expected="0-3,7")
        numbers = range(int(first), int(last if dash else first) + 1)
        if not numbers:
            raise ConfigurationError("sim.addresses", found=text, expected="0-3,7")
        found += numbers
    return list(dict.fromkeys(found))
