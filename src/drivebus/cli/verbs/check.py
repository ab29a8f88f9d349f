"""``check``: every mistake of a plant.toml, or what the plant will cost its lines. Opens no port, sends nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, voice
from drivebus.cli.command import Argument, Option, Verb
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.plant.config.arithmetic import BusCost, DriveCost
    from drivebus.plant.config.demands import Demand, Shortfall
    from drivebus.plant.model import PlantSetting


def _demand(text: str) -> Demand:
    from drivebus.plant.config import demands

    return demands.parse(text)


def _check(plant: str, demands: tuple[Demand, ...]) -> Exit:
    """2 where the file is refused (ConfigurationError), 1 where it does not keep what was demanded."""
    from drivebus.plant.config.arithmetic import costs
    from drivebus.plant.config.demands import shortfalls
    from drivebus.plant.config.load import load

    setting = load(plant)
    buses = costs(setting)
    short = {demand: list(shortfalls(demand, buses)) for demand in demands}
    code = Exit.REFUSED if any(short.values()) else Exit.DONE
    voice.document(_document(setting, buses, short, code))
    _show(setting, buses)
    for demand, found in short.items():
        if not found:
            voice.tell("plant_check.kept", demand=demand.text)
        for one in found:
            voice.note(f"plant_check.short_{demand.what}", **_words(one))
    return code


def _words(one: Shortfall) -> dict[str, Any]:
    demand = one.demand
    shown = [f"{value:.1f} %" if demand.what == "load" else seconds(value) for value in (one.found, demand.limit)]
    return {"name": one.name, "signal": one.signal, "found": shown[0], "limit": f"{demand.sign} {shown[1]}"}


def seconds(value_s: float) -> str:
    """As a person says it."""
    return f"{value_s * 1000:.0f} ms" if value_s < 1.0 else f"{value_s:.3g} s"


def _show(setting: PlantSetting, buses: tuple[BusCost, ...]) -> None:
    counts = {name: len(getattr(setting, name)) for name in ("buses", "drives", "groups", "interlocks", "alarms")}
    voice.tell("plant_check.good", file=setting.source, plant=setting.id, **counts)
    for bus in buses:
        voice.show("")
        voice.tell(
            "plant_check.bus", bus=bus.bus, link=bus.link, line=bus.line, load=f"{bus.load_percent:.0f}",
            cycle=seconds(bus.cycle_s), stop=seconds(bus.stop_bound_s),
        )  # fmt: skip
        voice.show(_table(bus))
        for drive in bus.drives:
            if drive.fastest_s:
                voice.tell("plant_check.paced", drive=drive.drive, pace=seconds(drive.fastest_s))


def _table(bus: BusCost) -> str:
    head = [voice.say(f"plant_check.{name}") for name in ("drive", "address", "model", "load", "stop", "refresh")]
    return voice.grid(head, [_row(drive) for drive in bus.drives])


def _row(drive: DriveCost) -> list[str]:
    load = f"{drive.load_percent:.0f} %"
    return [drive.drive, str(drive.address), drive.model, load, seconds(drive.stop_bound_s), _refresh(drive)]


def _refresh(drive: DriveCost) -> str:
    """``500 ms (≤ 1.2 s): output_frequency · 1 s (≤ 1.7 s): set_frequency``, the most often first."""
    alike: dict[tuple[float, float], list[str]] = {}
    for name, period_s in drive.periods.items():
        alike.setdefault((period_s, drive.refresh[name]), []).append(name)
    groups = (f"{seconds(times[0])} (≤ {seconds(times[1])}): {', '.join(alike[times])}" for times in sorted(alike))
    return " · ".join(groups)


def _document(
    setting: PlantSetting, buses: tuple[BusCost, ...], short: dict[Demand, list[Shortfall]], code: Exit
) -> dict[str, Any]:
    demands = [
        {
            "demand": demand.text,
            "kept": not found,
            "shortfalls": [{"name": one.name, "signal": one.signal, "found": round(one.found, 6)} for one in found],
        }
        for demand, found in short.items()
    ]
    lines = [_bus_document(bus) for bus in buses]
    return {
        "file": setting.source, "valid": True, "plant": setting.id, "buses": lines, "demands": demands,
        "exit": int(code),
    }  # fmt: skip


def _bus_document(bus: BusCost) -> dict[str, Any]:
    drives = [
        {
            "drive": one.drive,
            "address": one.address,
            "model": one.model,
            "load_percent": round(one.load_percent, 3),
            "stop_bound_s": round(one.stop_bound_s, 6),
            "fastest_s": one.fastest_s,
            "period_s": {name: round(value, 6) for name, value in one.periods.items()},
            "refresh_s": {name: round(value, 6) for name, value in one.refresh.items()},
        }
        for one in bus.drives
    ]
    return {
        "bus": bus.bus,
        "link": bus.link,
        "line": str(bus.line),
        "load_percent": round(bus.load_percent, 3),
        "cycle_s": round(bus.cycle_s, 6),
        "stop_bound_s": round(bus.stop_bound_s, 6),
        "drives": drives,
    }


command = Verb(
    "check",
    callback=_check,
    params=[
        Argument(["plant"], metavar="PLANT", type=click.Path(), key="help.argument.plant_file"),
        Option(
            ["--assert", "demands"],
            multiple=True,
            type=options.Parsed("demand", _demand, "plant_check.expect"),
            metavar="DEMAND",
            key="help.option.assert",
            example="--assert 'stop<250ms'",
        ),
    ],
    examples=(
        "drivebus check plant.toml",
        "drivebus check plant.toml --assert 'stop<250ms' --assert 'refresh<2s' --assert 'load<80%'",
        "drivebus check plant.toml --json",
    ),
)
