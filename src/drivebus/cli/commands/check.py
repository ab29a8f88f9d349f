"""``check``: errors of a plant.toml, or the load that the plant puts on its buses. Opens no port."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.errors import ExitCode, error_json
from drivebus.clock import wall_clock

if TYPE_CHECKING:
    from drivebus.service.config.bus_load import (
        BusLoadEstimate,
        DriveLoadEstimate,
        LoadRequirement,
        RequirementViolation,
    )
    from drivebus.service.config.certificates import CertificateState
    from drivebus.service.config.model import PlantConfig


def _parse_requirement(text: str) -> LoadRequirement:
    from drivebus.service.config import bus_load

    return bus_load.parse_requirement(text)


def _check(plant: str, requirements: tuple[LoadRequirement, ...]) -> ExitCode:
    """Return 1 if a requirement is missed. Raises ConfigurationError for an invalid file."""
    from drivebus.service.config.adapter_latency import adapter_latencies
    from drivebus.service.config.bus_load import bus_loads, violations
    from drivebus.service.config.certificates import certificate_states
    from drivebus.service.config.load import load
    from drivebus.service.process.clock_sync import is_clock_synchronized
    from drivebus.service.process.installed_files import changed_packages
    from drivebus.service.process.lock import directory_problems
    from drivebus.service.process.permissions import certificate_problems
    from drivebus.values import bilingual_text

    config = load(plant)
    buses, slow_adapters = bus_loads(config), tuple(adapter_latencies(config))
    missed = {requirement: list(violations(requirement, buses)) for requirement in requirements}
    lacks_asyncpg = config.history.url is not None and find_spec("asyncpg") is None
    code = ExitCode.FAILED if lacks_asyncpg or any(missed.values()) else ExitCode.DONE
    states, exposed = tuple(certificate_states(config)), list(certificate_problems(config))
    directory = list(directory_problems(config.directory))
    clock_synchronized, changed = is_clock_synchronized(), list(changed_packages())
    more = {
        "certificates": _certificate_documents(states),
        "slow_adapters": [asdict(slow) for slow in slow_adapters],
        "warnings": list(config.warnings),
        "exposed_files": [error_json(error)["error"] for error in exposed],
        "directory_problems": [error_json(error)["error"] for error in directory],
        "clock_synchronized": clock_synchronized,
        "changed_files": [str(file) for package in changed for file in package.files],
    }
    output.print_json(_document(config, buses, missed, code) | more)
    _print_loads(config, buses)
    for warning in config.warnings:
        output.print_note("plant_check.warning", text=warning.text(output.language()))
    for adapter in slow_adapters:
        output.print_note("ports.latency_cost", **adapter.text_params(bilingual_text("plant.bus", id=adapter.bus)))
    _print_certificates(states)
    for error in (*exposed, *directory):
        output.print_note("plant_check.warning", text=error.text(output.language()))
    for package in changed:
        output.print_note("plant_check.warning", text=output.text("plant.package_changed", **package.text_params()))
    if clock_synchronized is False:
        output.print_note("plant_check.warning", text=output.text("plant.clock_unsynchronized"))
    if lacks_asyncpg:
        output.print_note("history.no_asyncpg")
    for requirement, missed_values in missed.items():
        if not missed_values:
            output.print_message("plant_check.met", requirement=requirement.text)
        for violation in missed_values:
            output.print_note(f"plant_check.missed_{requirement.quantity}", **_violation_params(violation))
    return code


def _violation_params(violation: RequirementViolation) -> dict[str, Any]:
    requirement = violation.requirement
    estimate, limit = (
        f"{value:.1f} %" if requirement.quantity == "load" else format_seconds(value)
        for value in (violation.found, requirement.limit)
    )
    return {
        "name": violation.name,
        "signal": violation.signal,
        "found": estimate,
        "limit": f"{requirement.sign} {limit}",
    }


def format_seconds(value_s: float) -> str:
    """Format ``250 ms`` or ``1.2 s``."""
    return f"{value_s * 1000:.0f} ms" if value_s < 1.0 else f"{value_s:.3g} s"


def _print_loads(config: PlantConfig, buses: tuple[BusLoadEstimate, ...]) -> None:
    counts = {name: len(getattr(config, name)) for name in ("buses", "drives", "groups", "interlocks", "alarms")}
    output.print_message("plant_check.good", file=config.source, plant=config.id, **counts)
    for bus in buses:
        output.print_text("")
        output.print_message(
            "plant_check.bus",
            bus=bus.bus,
            port=bus.port,
            serial=bus.serial_settings,
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


def _print_certificates(states: Sequence[CertificateState]) -> None:
    """Print the end of each certificate, and what is to be mended. It is no error: drives run without the page."""
    now = wall_clock()
    for state in states:
        params = {
            "file": state.certificate,
            "gateway": state.gateway,
            "until": f"{state.valid_until:%Y-%m-%d %H:%M} UTC",
        }
        if state.is_early(now):
            output.print_note("plant.certificate_early", **state.begin_params)
        if state.is_expired(now):
            output.print_note("plant_check.certificate_ended", **params)
        elif state.ends_soon(now):
            output.print_note("plant_check.certificate_ends", **params)
        else:
            output.print_message("plant_check.certificate", **params)


def _certificate_documents(states: Sequence[CertificateState]) -> list[dict[str, Any]]:
    return [
        {
            "gateway": state.gateway,
            "certificate": str(state.certificate),
            "valid_from": state.valid_from.isoformat(),
            "valid_until": state.valid_until.isoformat(),
            "key": str(state.key),
            "key_mode": f"{state.key_mode:o}",
        }
        for state in states
    ]


def _table(bus: BusLoadEstimate) -> str:
    head = [output.text(f"plant_check.{name}") for name in ("drive", "address", "model", "load", "stop", "refresh")]
    return output.fitted_table(head, [_row(drive) for drive in bus.drives])


def _row(drive: DriveLoadEstimate) -> list[str]:
    load = f"{drive.load_percent:.0f} %"
    return [drive.drive, str(drive.address), drive.model, load, format_seconds(drive.stop_bound_s), _refresh(drive)]


def _refresh(drive: DriveLoadEstimate) -> str:
    """Format ``500 ms (≤ 1.2 s): output_frequency · 1 s (≤ 1.7 s): set_frequency``, the shortest period first."""
    alike: dict[tuple[float, float], list[str]] = {}
    for name, period_s in drive.periods.items():
        alike.setdefault((period_s, drive.refresh[name]), []).append(name)
    groups = (
        f"{format_seconds(times[0])} (≤ {format_seconds(times[1])}): {output.join(alike[times], 'items')}"
        for times in sorted(alike)
    )
    return " · ".join(groups)


def _document(
    config: PlantConfig,
    buses: tuple[BusLoadEstimate, ...],
    missed: dict[LoadRequirement, list[RequirementViolation]],
    code: ExitCode,
) -> dict[str, Any]:
    requirements = [
        {
            "requirement": requirement.text,
            "met": not violations,
            "violations": [
                {"name": violation.name, "signal": violation.signal, "found": round(violation.found, 6)}
                for violation in violations
            ],
        }
        for requirement, violations in missed.items()
    ]
    return {
        "file": config.source,
        "valid": True,
        "plant": config.id,
        "buses": [_bus_document(bus) for bus in buses],
        "requirements": requirements,
        "exit": int(code),
    }


def _bus_document(bus: BusLoadEstimate) -> dict[str, Any]:
    drives = [
        {
            "drive": drive.drive,
            "address": drive.address,
            "model": drive.model,
            "load_percent": round(drive.load_percent, 3),
            "stop_bound_s": round(drive.stop_bound_s, 6),
            "min_poll_interval_s": drive.min_poll_interval_s,
            "period_s": {name: round(value, 6) for name, value in drive.periods.items()},
            "refresh_s": {name: round(value, 6) for name, value in drive.refresh.items()},
        }
        for drive in bus.drives
    ]
    return {
        "bus": bus.bus,
        "port": bus.port,
        "serial": str(bus.serial_settings),
        "load_percent": round(bus.load_percent, 3),
        "cycle_s": round(bus.cycle_s, 6),
        "stop_bound_s": round(bus.stop_bound_s, 6),
        "drives": drives,
    }


command = CliCommand(
    "check",
    callback=_check,
    params=[
        Argument(["plant"], metavar="PLANT.toml", type=click.Path(), key="help.argument.plant_file"),
        Option(
            ["--assert", "requirements"],
            multiple=True,
            type=options.ParsedType("requirement", _parse_requirement, "plant_check.expect"),
            metavar="REQUIREMENT",
            key="help.option.assert",
            example="--assert 'stop<250ms'",
        ),
    ],
    examples=(
        "drivebus check plant.toml",
        "drivebus check plant.toml --assert 'stop<250ms' --assert 'load<80%'",
        "drivebus check plant.toml --json",
    ),
)
