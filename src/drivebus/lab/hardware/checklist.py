"""The steps of the checklist, in order. Each knows what it needs, does one thing and says what it found."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from drivebus.errors import DrivebusError
from drivebus.lab.hardware import handling, line, motion

if TYPE_CHECKING:
    from drivebus.lab.hardware.rig import Rig


class Needs(StrEnum):
    """What a step asks for beside the line."""

    NOTHING = "nothing"
    """It only reads."""
    HANDS = "hands"
    """A person who pulls a plug or turns a switch."""
    MOTOR = "motor"
    """A motor that may turn, and a person who watches it."""


class Verdict(StrEnum):
    """How a step ended."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """Not done: nobody there, not wanted, or nothing to be seen on this port."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What one step found. ``figures`` are what was measured, units in their names."""

    step: str
    verdict: Verdict
    figures: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    """Key of the sentence that says why, where there is one to say."""


Step = Callable[["Rig"], Awaitable[tuple[bool | None, dict[str, Any]]]]

STEPS: Mapping[str, tuple[Needs, Step]] = {
    "port": (Needs.NOTHING, line.port),
    "owner": (Needs.NOTHING, line.owner),
    "quiet": (Needs.NOTHING, line.quiet),
    "answers": (Needs.NOTHING, line.answers),
    "fences": (Needs.NOTHING, line.fences),
    "parity": (Needs.NOTHING, line.parity),
    "unplug": (Needs.HANDS, handling.unplug),
    "power": (Needs.HANDS, handling.power),
    "run_and_stop": (Needs.MOTOR, motion.run_and_stop),
    "host_dies": (Needs.MOTOR, motion.host_dies),
}
"""In this order: nothing moves before everything that only reads has been seen."""


async def perform(name: str, rig: Rig) -> Finding:
    """One step. Without a person, or without leave for the motor, it is skipped and so said."""
    needs, step = STEPS[name]
    if needs is Needs.MOTOR and not rig.motor:
        return Finding(name, Verdict.SKIPPED, reason="hardware.no_motor")
    if needs is not Needs.NOTHING and not await rig.agreed(f"hardware.ask.{name}", frequency_hz=rig.frequency_hz):
        return Finding(name, Verdict.SKIPPED, reason="hardware.nobody")
    try:
        good, figures = await step(rig)
    except DrivebusError as error:
        return Finding(name, Verdict.FAILED, {"error": error}, f"hardware.bad.{name}" if name != "port" else "")
    if good is None:
        return Finding(name, Verdict.SKIPPED, figures, f"hardware.not.{name}")
    return Finding(name, Verdict.PASSED if good else Verdict.FAILED, figures, "" if good else f"hardware.bad.{name}")
