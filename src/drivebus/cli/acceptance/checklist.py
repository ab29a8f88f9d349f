"""The steps of the checklist, in order. Each knows what it needs, does one thing and says what it found."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from drivebus.cli.acceptance import bus_steps, handling_steps, motion_steps
from drivebus.errors import DrivebusError

if TYPE_CHECKING:
    from drivebus.cli.acceptance.session import AcceptanceSession


class StepRequirement(StrEnum):
    """What a step asks for beside the line."""

    NOTHING = "nothing"
    """It only reads."""
    PERSON = "hands"
    """A person who pulls a plug or turns a switch."""
    MOTOR = "motor"
    """A motor that may turn, and a person who watches it."""


class StepResult(StrEnum):
    """How a step ended."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """Not done: nobody there, not wanted, or nothing to be seen on this port."""


@dataclass(frozen=True, slots=True)
class StepFinding:
    """What one step found. ``figures`` are what was measured, units in their names."""

    step: str
    verdict: StepResult
    figures: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    """Key of the sentence that says why, where there is one to say."""


AcceptanceStep = Callable[["AcceptanceSession"], Awaitable[tuple[bool | None, dict[str, Any]]]]

ACCEPTANCE_STEPS: Mapping[str, tuple[StepRequirement, AcceptanceStep]] = {
    "port": (StepRequirement.NOTHING, bus_steps.check_port),
    "owner": (StepRequirement.NOTHING, bus_steps.check_exclusive),
    "quiet": (StepRequirement.NOTHING, bus_steps.check_quiet),
    "answers": (StepRequirement.NOTHING, bus_steps.check_reply_times),
    "fences": (StepRequirement.NOTHING, bus_steps.check_sync_probes),
    "parity": (StepRequirement.NOTHING, bus_steps.check_parity),
    "unplug": (StepRequirement.PERSON, handling_steps.check_unplug),
    "power": (StepRequirement.PERSON, handling_steps.check_power_loss),
    "run_and_stop": (StepRequirement.MOTOR, motion_steps.check_run_and_stop),
    "host_dies": (StepRequirement.MOTOR, motion_steps.check_communication_loss),
}
"""In this order: nothing moves before everything that only reads has been seen."""


async def run_step(name: str, rig: AcceptanceSession) -> StepFinding:
    """One step. Without a person, or without leave for the motor, it is skipped and so said."""
    needs, step = ACCEPTANCE_STEPS[name]
    if needs is StepRequirement.MOTOR and not rig.motor:
        return StepFinding(name, StepResult.SKIPPED, reason="hardware.no_motor")
    if needs is not StepRequirement.NOTHING and not await rig.confirm(
        f"hardware.ask.{name}", frequency_hz=rig.frequency_hz
    ):
        return StepFinding(name, StepResult.SKIPPED, reason="hardware.nobody")
    try:
        good, figures = await step(rig)
    except DrivebusError as error:
        return StepFinding(name, StepResult.FAILED, {"error": error}, f"hardware.bad.{name}" if name != "port" else "")
    if good is None:
        return StepFinding(name, StepResult.SKIPPED, figures, f"hardware.not.{name}")
    return StepFinding(
        name, StepResult.PASSED if good else StepResult.FAILED, figures, "" if good else f"hardware.bad.{name}"
    )
