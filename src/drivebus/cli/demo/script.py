"""Script of the demo: steps with their times and captions, and the player that executes them as a client."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Literal

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.demo.layout import BUSES
from drivebus.cli.demo.plant import DemoPlant
from drivebus.cli.remote.convert import parse_outcome
from drivebus.cli.stop_result import drives_by_status, result_text
from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.service.api.operations.control import LEASE_RELEASE
from drivebus.service.api.operations.drives import (
    DRIVE_RESET,
    DRIVE_RUN,
    DRIVE_SET_FREQUENCY,
    DRIVE_STOP,
)
from drivebus.service.api.operations.plant import PLANT_STOP
from drivebus.types import Json

Action = Literal["run", "set", "stop", "trip", "reset", "unplug", "plug", "stop_all", "message"]
Call = Callable[[str, Json], Awaitable[Json]]
"""An operation of the service: name and parameters."""


@dataclass(frozen=True, slots=True)
class ScriptStep:
    """An action on ``subject`` (a drive, a bus or a message) ``at_s`` seconds after the begin."""

    at_s: float
    action: Action
    subject: str = ""
    frequency_hz: float = 0.0


OPENING = (
    ScriptStep(1.0, "message", "welcome"),
    ScriptStep(2.0, "run", "fan-1", 30.0),
    ScriptStep(3.0, "run", "spindle-1", 50.0),
    ScriptStep(4.0, "run", "conveyor-1", 20.0),
    ScriptStep(5.0, "run", "pump-1", 35.0),
    ScriptStep(7.0, "run", "fan-2", 40.0),
    ScriptStep(9.0, "run", "fan-3", 45.0),
    ScriptStep(11.0, "run", "pump-2", 30.0),
    ScriptStep(13.0, "run", "spindle-2", 40.0),
    ScriptStep(15.0, "set", "fan-1", 50.0),
    ScriptStep(20.0, "trip", "fan-3"),
)
"""Steps of every demo."""
PAGE_CONTINUATION = (
    ScriptStep(40.0, "unplug", "C"),
    ScriptStep(48.0, "plug", "C"),
    ScriptStep(58.0, "message", "yours"),
)
"""Further steps of the demo in the browser; the fault is left to the user."""
TERMINAL_CONTINUATION = (
    ScriptStep(23.0, "reset", "fan-3"),
    ScriptStep(25.0, "run", "fan-3", 30.0),
    ScriptStep(27.0, "unplug", "C"),
    ScriptStep(31.0, "plug", "C"),
    ScriptStep(33.0, "set", "conveyor-1", 10.0),
    ScriptStep(34.0, "stop", "fan-2"),
    ScriptStep(36.0, "stop_all"),
)
"""Further steps of the demo in the terminal."""
END_S = 44.0  # after the last ramp


def caption(step: ScriptStep) -> Json:
    """Return the notice of the page for a step."""
    name = step.subject if step.action == "message" else step.action
    role, _, number = step.subject.partition("-")
    return {
        language: i18n.text(
            f"demo.story.{name}",
            language,
            name=i18n.text(f"demo.role.{role}", language, number=number) if number else "",
            bus=step.subject,
            hz=f"{step.frequency_hz:g}",
        )
        for language in i18n.LANGUAGES
    }


class ScriptPlayer:
    """Player of steps until they end or the user takes over; ``report`` gets each message, ``on_step`` each step."""

    def __init__(
        self,
        call: Call,
        plant: DemoPlant,
        report: Callable[[str], None],
        on_step: Callable[[ScriptStep], None] = lambda step: None,
    ) -> None:
        self._call = call
        self._plant = plant
        self._report = report
        self._on_step = on_step
        self._started_at = 0.0
        self._taken_over = asyncio.Event()
        self._commands: set[asyncio.Task[None]] = set()

    def take_over(self) -> None:
        """End the script: the user commands the plant now."""
        if not self._taken_over.is_set():
            self.report("demo.taken_over")
        self._taken_over.set()

    async def play(self, steps: tuple[ScriptStep, ...], end_s: float | None = None) -> None:
        """Execute the steps, then wait for ``end_s``; return at once when the user takes over."""
        self._started_at = self._now()
        try:
            for step in steps:
                if await self._is_taken_over_before(step.at_s):
                    return
                self._start(step)
            if end_s is not None and not await self._is_taken_over_before(end_s):
                self.report("demo.end")
        finally:
            await asyncio.gather(*self._commands, return_exceptions=True)

    @property
    def taken_over(self) -> bool:
        return self._taken_over.is_set()

    def report(self, key: str, **params: Any) -> None:
        """Report a message with the time since the begin."""
        seconds = int(self._now() - self._started_at)
        self._report(f"{seconds // 60}:{seconds % 60:02d}  {output.text(key, **params)}")

    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    async def _is_taken_over_before(self, at_s: float) -> bool:
        try:
            await asyncio.wait_for(self._taken_over.wait(), max(0.0, self._started_at + at_s - self._now()))
        except TimeoutError:
            return False
        return True

    def _start(self, step: ScriptStep) -> None:
        self._on_step(step)
        if step.action == "message":
            self.report(f"demo.{step.subject}")
        elif step.action in ("unplug", "plug"):
            self.report(f"demo.{step.action}", bus=step.subject)
            self._plant.apply({"do": step.action, "bus": [bus.name for bus in BUSES].index(step.subject)})
        elif step.action == "trip":
            self.report("demo.trip", name=drive_name(step.subject))
            self._plant.apply({"do": "trip", **_place_of(step.subject)})
        else:
            task = asyncio.create_task(self._command(step))
            self._commands.add(task)
            task.add_done_callback(self._commands.discard)

    async def _command(self, step: ScriptStep) -> None:
        name = drive_name(step.subject) if step.subject else ""
        self.report(f"demo.{step.action}", name=name, hz=f"{step.frequency_hz:g}")
        try:
            if step.action == "stop_all":
                self.report("demo.stopped_all", text=stop_all_text(await self._call(PLANT_STOP.name, {})))
                return
            result = await self._call(OPERATIONS[step.action], _params(step))
            if step.action != "stop":
                await self._call(LEASE_RELEASE.name, {"drive": step.subject})
        except ServiceUnavailable:
            return
        except DrivebusError as error:
            self.report("demo.failed", name=name, text=error.text(output.language()))
        else:
            self.report("demo.outcome", name=name, text=outcome_text(result))


OPERATIONS = {
    "run": DRIVE_RUN.name,
    "set": DRIVE_SET_FREQUENCY.name,
    "stop": DRIVE_STOP.name,
    "reset": DRIVE_RESET.name,
}


def _params(step: ScriptStep) -> Json:
    return {"drive": step.subject} | ({"frequency_hz": step.frequency_hz} if step.frequency_hz else {})


def _place_of(drive: str) -> dict[str, int]:
    """Return bus index and address of a drive."""
    for index, bus in enumerate(BUSES):
        for part in bus.drives:
            if part.key == drive:
                return {"bus": index, "address": part.address}
    raise KeyError(drive)


def outcome_text(result: Json) -> str:
    """Format the outcome of an operation."""
    return parse_outcome(result).text(output.language())


def stop_all_text(result: Json) -> str:
    """Format the drives by the status of their stop."""
    return result_text(drives_by_status(result["outcomes"]))


def drive_name(key: str) -> str:
    """Return the name of a drive such as ``fan 1`` in the user's language."""
    role, _, number = key.partition("-")
    return output.text(f"demo.role.{role}", number=number)
