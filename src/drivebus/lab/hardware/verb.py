"""The verb: steps one after the other, each told as it ends; then the dated report, JSON and text."""

from __future__ import annotations

import asyncio
import json
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivebus.cli import options, voice
from drivebus.cli.command import Option, Verb
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import target_of
from drivebus.cli.exits import Exit
from drivebus.lab.hardware.checklist import STEPS, Finding, Verdict, perform
from drivebus.lab.hardware.rig import Ended, Rig

GENTLE_HZ = 5.0


def _hardware(motor: bool, frequency: float, folder: Path, **given: Any) -> Exit:
    return asyncio.run(_run(target_of(given), motor, frequency, folder))


async def _run(target: Target, motor: bool, frequency_hz: float, folder: Path) -> Exit:
    from drivebus.cli.ending import listening

    findings: list[Finding] = []
    with listening() as ending:
        rig = Rig(target, ending, motor, frequency_hz)
        try:
            for name in STEPS:
                findings.append(await perform(name, rig))
                _tell(findings[-1])
        except Ended:
            voice.note("cli.interrupted")
        finally:
            _write(folder, target, findings)
    if ending.come:
        return Exit.INTERRUPTED
    return Exit.REFUSED if any(one.verdict is Verdict.FAILED for one in findings) else Exit.DONE


def _tell(finding: Finding) -> None:
    voice.document(_plain(finding), stream=True)
    voice.show(_line(finding))


def _line(finding: Finding) -> str:
    figures = ", ".join(f"{name}={value}" for name, value in _figures(finding).items())
    reason = voice.say(finding.reason) if finding.reason else ""
    said = voice.say(f"hardware.step.{finding.step}")
    parts = [f"[{voice.say(f'hardware.{finding.verdict}')}] {said}", figures, reason]
    return "\n    ".join(part for part in parts if part)


def _figures(finding: Finding) -> dict[str, Any]:
    """Errors as sentences."""
    texts = {name: getattr(value, "text", None) for name, value in finding.figures.items()}
    return {
        name: said(voice.language()) if callable(said := texts[name]) else value
        for name, value in finding.figures.items()
    }


def _plain(finding: Finding) -> dict[str, Any]:
    return {
        "step": finding.step, "verdict": str(finding.verdict), "figures": _figures(finding),
        "reason": finding.reason and voice.say(finding.reason),
    }  # fmt: skip


def _write(folder: Path, target: Target, findings: list[Finding]) -> None:
    """``drivebus-hardware-<date>.json`` and ``.md``; never over an older report."""
    now = datetime.now().astimezone()
    path = folder / f"drivebus-hardware-{now:%Y%m%d-%H%M%S}"
    head = {
        "date": now.isoformat(timespec="seconds"), "drivebus": version("drivebus"), "link": target.link,
        "model": target.model, "address": target.address,
    }  # fmt: skip
    document = head | {"findings": [_plain(one) for one in findings]}
    text = voice.say("hardware.title", **head) + "\n\n" + "\n".join(f"- {_line(one)}" for one in findings) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, content in ((".json", json.dumps(document, indent=1, ensure_ascii=False) + "\n"), (".md", text)):
        with path.with_suffix(suffix).open("x", encoding="utf-8") as file:
            file.write(content)
    voice.tell("lab_verb.written", path=path.with_suffix(".md"))


command = Verb(
    "hardware",
    topic="lab.hardware",
    callback=_hardware,
    params=[
        *options.drive(),
        Option(["--motor"], is_flag=True, key="hardware.option_motor"),
        Option(
            ["--frequency"], type=options.Number(0.5, 10.0), default=GENTLE_HZ, metavar="HZ",
            key="hardware.option_frequency", example="--frequency 5",
        ),
        Option(
            ["--folder"], type=options.FOLDER, default=Path(), metavar="FOLDER",
            key="hardware.option_folder", example="--folder reports",
        ),
    ],
    examples=(
        "drivebus lab hardware /dev/ttyUSB0 --model vc660 --address 1",
        "drivebus lab hardware /dev/ttyUSB0 --model c320 --address 1 --motor --frequency 5",
    ),
)  # fmt: skip
