"""The verb: steps one after the other, each told as it ends; then the dated report, JSON and text."""

from __future__ import annotations

import asyncio
import json
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivebus.cli import options, output
from drivebus.cli.acceptance.checklist import ACCEPTANCE_STEPS, StepFinding, StepResult, run_step
from drivebus.cli.acceptance.session import AcceptanceInterrupted, AcceptanceSession
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import pop_target
from drivebus.cli.errors import ExitCode

ACCEPTANCE_FREQUENCY_HZ = 5.0


def _acceptance(motor: bool, frequency: float, folder: Path, **given: Any) -> ExitCode:
    return asyncio.run(_run(pop_target(given), motor, frequency, folder))


async def _run(target: Target, motor: bool, frequency_hz: float, folder: Path) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals

    findings: list[StepFinding] = []
    with shutdown_signals() as ending:
        rig = AcceptanceSession(target, ending, motor, frequency_hz)
        try:
            for name in ACCEPTANCE_STEPS:
                findings.append(await run_step(name, rig))
                _print_finding(findings[-1])
        except AcceptanceInterrupted:
            output.print_note("cli.interrupted")
        finally:
            _write(folder, target, findings)
    if ending.received:
        return ExitCode.INTERRUPTED
    return ExitCode.FAILED if any(one.verdict is StepResult.FAILED for one in findings) else ExitCode.DONE


def _print_finding(finding: StepFinding) -> None:
    output.print_json(_plain(finding), stream=True)
    output.print_text(_line(finding))


def _line(finding: StepFinding) -> str:
    figures = ", ".join(f"{name}={value}" for name, value in _figures(finding).items())
    reason = output.text(finding.reason) if finding.reason else ""
    said = output.text(f"hardware.step.{finding.step}")
    parts = [f"[{output.text(f'hardware.{finding.verdict}')}] {said}", figures, reason]
    return "\n    ".join(part for part in parts if part)


def _figures(finding: StepFinding) -> dict[str, Any]:
    """Errors as sentences."""
    texts = {name: getattr(value, "text", None) for name, value in finding.figures.items()}
    return {
        name: said(output.language()) if callable(said := texts[name]) else value
        for name, value in finding.figures.items()
    }


def _plain(finding: StepFinding) -> dict[str, Any]:
    return {
        "step": finding.step,
        "verdict": str(finding.verdict),
        "figures": _figures(finding),
        "reason": finding.reason and output.text(finding.reason),
    }


def _write(folder: Path, target: Target, findings: list[StepFinding]) -> None:
    """``drivebus-hardware-<date>.json`` and ``.md``; never over an older report."""
    now = datetime.now().astimezone()
    path = folder / f"drivebus-hardware-{now:%Y%m%d-%H%M%S}"
    head = {
        "date": now.isoformat(timespec="seconds"),
        "drivebus": version("drivebus"),
        "port": target.port,
        "model": target.model,
        "address": target.address,
    }
    document = head | {"findings": [_plain(one) for one in findings]}
    text = output.text("hardware.title", **head) + "\n\n" + "\n".join(f"- {_line(one)}" for one in findings) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, content in ((".json", json.dumps(document, indent=1, ensure_ascii=False) + "\n"), (".md", text)):
        with path.with_suffix(suffix).open("x", encoding="utf-8") as file:
            file.write(content)
    output.print_message("lab_verb.written", path=path.with_suffix(".md"))


command = CliCommand(
    "hardware",
    help_key="lab.hardware",
    callback=_acceptance,
    params=[
        *options.drive_options(),
        Option(["--motor"], is_flag=True, key="hardware.option_motor"),
        Option(
            ["--frequency"],
            type=options.NumberType(0.5, 10.0),
            default=ACCEPTANCE_FREQUENCY_HZ,
            metavar="HZ",
            key="hardware.option_frequency",
            example="--frequency 5",
        ),
        Option(
            ["--folder"],
            type=options.FOLDER,
            default=Path(),
            metavar="FOLDER",
            key="hardware.option_folder",
            example="--folder reports",
        ),
    ],
    examples=(
        "drivebus lab hardware /dev/ttyUSB0 --model vc660 --address 1",
        "drivebus lab hardware /dev/ttyUSB0 --model c320 --address 1 --motor --frequency 5",
    ),
)
