"""Load of a bus per model, from the product's own estimate: the table of the timing page."""

from __future__ import annotations

from drivebus import profiles
from drivebus.bus import Poll, estimate_bus_load
from drivebus.drives import create_dialect
from drivebus.serial_settings import SerialSettings
from drivebus.values import Text
from generator.drives import MODELS_WITH_PAGE
from generator.terms import localized, table

COUNTS = (1, 10, 31)
PERIOD_S = 1.0
HEADS = {
    "model": Text("model", "型号"),
    "serial": Text("serial settings", "通信参数"),
    "status": Text("a status read*", "一次状态读取*"),
    "load": Text("load, drives read once a second: {n}", "每秒各读一次时的负载：{n} 台"),
    "stop": Text("stop bound, 31 drives", "停机上限（31 台）"),
}


def bus_load_table(language: str) -> str:
    """Return status read, load of 1, 10 and 31 drives, and stop bound of each model at factory settings."""
    loads = [localized(HEADS["load"], language).replace("{n}", str(count)) for count in COUNTS]
    heads = [localized(HEADS[name], language) for name in ("model", "serial", "status")]
    return table([*heads, *loads, localized(HEADS["stop"], language)], [_row(model) for model in MODELS_WITH_PAGE])


def _row(model: str) -> list[str]:
    profile = profiles.load(model)
    settings = SerialSettings.parse(profile.serial.baud, profile.serial.format)
    found = [estimate_bus_load(_plan(profile, count), settings) for count in COUNTS]
    loads = [f"{load.load_percent:.0f} %" for load in found]
    bound_s = max(drive.stop_bound_s for drive in found[-1].drives.values())
    return [
        f"`{model}`",
        f"{settings.baud} {settings.format}",
        f"{1000 * found[0].cycle_s:.0f} ms",
        *loads,
        f"{1000 * bound_s:.0f} ms",
    ]


def _plan(profile: profiles.DriveProfile, count: int) -> list[tuple[object, list[Poll]]]:
    low, high = profile.addresses
    addresses = [address for address in range(max(low, 1), high + 1) if address != profile.broadcast][:count]
    dialects = [create_dialect(profile, address) for address in addresses]
    return [
        (
            dialect.station_config,
            [Poll(request, PERIOD_S) for request in dialect.state_reads() or (dialect.echo_test_read(),)],
        )
        for dialect in dialects
    ]
