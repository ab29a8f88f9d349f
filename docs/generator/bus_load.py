"""What a line can carry, from the product's own arithmetic: the tables of the timing page."""

from __future__ import annotations

from drivebus import profiles
from drivebus.bus import Poll, estimate_bus_load
from drivebus.drives import create_dialect
from drivebus.serial_settings import SerialSettings
from drivebus.values import Text
from generator.words import side, table

FAMILIES = ("c320", "dzb100", "vc660", "df800")
COUNTS = (1, 10, 31)
PERIOD_S = 1.0
HEADS = {
    "model": Text("model", "型号"),
    "line": Text("line", "线路"),
    "status": Text("a status read*", "一次状态读取*"),
    "load": Text("load, drives read once a second: {n}", "每秒各读一次时的负载：{n} 台"),
    "stop": Text("stop bound, 31 drives", "停机上限（31 台）"),
}


def bus_load_page(language: str) -> str:
    """Per family at its factory line: the cost of a status read, the load of 1, 10 and 31 drives, the stop bound."""
    loads = [side(HEADS["load"], language).replace("{n}", str(count)) for count in COUNTS]
    heads = [side(HEADS[name], language) for name in ("model", "line", "status")]
    return table([*heads, *loads, side(HEADS["stop"], language)], [_row(model) for model in FAMILIES])


def _row(model: str) -> list[str]:
    profile = profiles.load(model)
    line = SerialSettings.parse(profile.serial.baud, profile.serial.format)
    found = [estimate_bus_load(_plan(profile, count), line) for count in COUNTS]
    loads = [f"{one.load_percent:.0f} %" for one in found]
    bound_s = max(drive.stop_bound_s for drive in found[-1].drives.values())
    return [
        f"`{model}`",
        f"{line.baud} {line.format}",
        f"{1000 * found[0].cycle_s:.0f} ms",
        *loads,
        f"{1000 * bound_s:.0f} ms",
    ]


def _plan(profile: profiles.DriveProfile, count: int) -> list[tuple[object, list[Poll]]]:
    low, high = profile.addresses
    addresses = [address for address in range(max(low, 1), high + 1) if address != profile.broadcast][:count]
    dialects = [create_dialect(profile, address) for address in addresses]
    return [
        (one.station_config, [Poll(request, PERIOD_S) for request in one.state_reads() or (one.echo_test_read(),)])
        for one in dialects
    ]
