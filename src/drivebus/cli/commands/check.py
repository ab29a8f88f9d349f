"""``check``: errors of a plant.toml, or the load that the plant puts on its buses. Opens no port."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.service.config.bus_load import (
        BusLoadEstimate,
        DriveLoadEstimate,
        LoadRequirement,
        RequirementViolation,
    )
    from drivebus.service.config.model import PlantConfig


def _demand(text: str) -> LoadRequirement:
    from drivebus.service.config import bus_load

    return bus_load.parse_requirement(text)


def _check(plant: str, requirements: tuple[LoadRequirement, ...]) -> ExitCode:
    """2 where the file is refused (ConfigurationError), 1 where it does not keep what was demanded."""
    from drivebus.service.config.bus_load import bus_loads, violations
    from drivebus.service.config.load import load

    setting = load(plant)
    buses = bus_loads(setting)
    short = {demand: list(violations(demand, buses)) for demand in requirements}
    code = ExitCode.FAILED if any(short.values()) else ExitCode.DONE
    output.print_json(_document(setting, buses, short, code))
    _show(setting, buses)
    for demand, found in short.items():
        if not found:
            output.print_message("plant_check.kept", demand=demand.text)
        for one in found:
            output.print_note(f"plant_check.short_{demand.quantity}", **_violation_params(one))
    return code


def _violation_params(one: RequirementViolation) -> dict[str, Any]:
    demand = one.requirement
    shown = [
        f"{value:.1f} %" if demand.quantity == "load" else format_seconds(value) for value in (one.found, demand.limit)
    ]
    return {"name": one.name, "signal": one.signal, "found": shown[0], "limit": f"{demand.sign} {shown[1]}"}


def format_seconds(value_s: float) -> str:
    """Format ``250 ms`` or ``1.2 s``."""
    return f"{value_s * 1000:.0f} ms" if value_s < 1.0 else f"{value_s:.3g} s"


def _show(setting: PlantConfig, buses: tuple[BusLoadEstimate, ...]) -> None:
    counts = {name: len(getattr(setting, name)) for name in ("buses", "drives", "groups", "interlocks", "alarms")}
    output.print_message("plant_check.good", file=setting.source, plant=setting.id, **counts)
    for bus in buses:
        output.print_text("")
        output.print_message(
            "plant_check.bus",
            bus=bus.bus,
            link=bus.link,
            line=bus.serial_settings,
            load=f"{bus.load_percent:.0f}",
            cycle=format_seconds(bus.cycle_s),
            stop=format_seconds(bus.stop_bound_s),
        )
        output.print_text(_table(bus))
        for drive in bus.drives:
            if drive.min_poll_interval_s:
                output.print_message(
                    "plant_check.paced", drive=drive.drive, pace=format_seconds(drive.min_poll_interval_s)
                )


def _table(bus: BusLoadEstimate) -> str:
    head = [output.text(f"plant_check.{name}") for name in ("drive", "address", "model", "load", "stop", "refresh")]
    return output.fitted_table(head, [_row(drive) for drive in bus.drives])


def _row(drive: DriveLoadEstimate) -> list[str]:
    load = f"{drive.load_percent:.0f} %"
    return [drive.drive, str(drive.address), drive.model, load, format_seconds(drive.stop_bound_s), _refresh(drive)]


def _refresh(drive: DriveLoadEstimate) -> str:
    """``500 ms (≤ 1.2 s): output_frequency · 1 s (≤ 1.7 s): set_frequency``, the most often first."""
    alike: dict[tuple[float, float], list[str]] = {}
    for name, period_s in drive.periods.items():
        alike.setdefault((period_s, drive.refresh[name]), []).append(name)
    groups = (
        f"{format_seconds(times[0])} (≤ {format_seconds(times[1])}): {', '.join(alike[times])}"
        for times in sorted(alike)
    )
    return " · ".join(groups)


def _document(
    setting: PlantConfig,
    buses: tuple[BusLoadEstimate, ...],
    short: dict[LoadRequirement, list[RequirementViolation]],
    code: ExitCode,
) -> dict[str, Any]:
    requirements = [
        {
            "demand": demand.text,
            "kept": not found,
            "shortfalls": [{"name": one.name, "signal": one.signal, "found": round(one.found, 6)} for one in found],
        }
        for demand, found in short.items()
    ]
    lines = [_bus_document(bus) for bus in buses]
    return {
        "file": setting.source,
        "valid": True,
        "plant": setting.id,
        "buses": lines,
        "demands": requirements,
        "exit": int(code),
    }


def _bus_document(bus: BusLoadEstimate) -> dict[str, Any]:
    drives = [
        {
            "drive": one.drive,
            "address": one.address,
            "model": one.model,
            "load_percent": round(one.load_percent, 3),
            "stop_bound_s": round(one.stop_bound_s, 6),
            "min_poll_interval_s": one.min_poll_interval_s,
            "period_s": {name: round(value, 6) for name, value in one.periods.items()},
            "refresh_s": {name: round(value, 6) for name, value in one.refresh.items()},
        }
        for one in bus.drives
    ]
    return {
        "bus": bus.bus,
        "link": bus.link,
        "line": str(bus.serial_settings),
        "load_percent": round(bus.load_percent, 3),
        "cycle_s": round(bus.cycle_s, 6),
        "stop_bound_s": round(bus.stop_bound_s, 6),
        "drives": drives,
    }


command = CliCommand(
    "check",
    callback=_check,
    params=[
        Argument(["plant"], metavar="PLANT", type=click.Path(), key="help.argument.plant_file"),
        Option(
            ["--assert", "requirements"],
            multiple=True,
            type=options.ParsedType("demand", _demand, "plant_check.expect"),
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
