"""Undocumented options of one drive that were determined on the bench, and their storage."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import replace
from typing import Any

from drivebus.drives.operations.calibration import (
    CalibrationResult,
    CalibrationStep,
    calibration_step,
    calibration_steps,
)
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.outcome import raise_for_status
from drivebus.drives.runner import OperationRunner
from drivebus.drives.stop_supervisor import StopSupervisor
from drivebus.drives.store import Store, drive_key, value_if_readable


class Calibration:
    """Calibration of one drive: runs the bench procedures and stores what they determine."""

    def __init__(
        self, runner: OperationRunner, stops: StopSupervisor, store: Store, explicit_options: Collection[str]
    ) -> None:
        """``explicit_options``: options that the user gave; a stored value never replaces them."""
        self._runner, self._stops, self._store = runner, stops, store
        self._dialect = runner.drive.dialect
        self._explicit_options = explicit_options

    def open_steps(self) -> tuple[CalibrationStep, ...]:
        """Return the steps that are still to be done on this drive."""
        return tuple(step for step in calibration_steps(self._dialect) if step.is_open(self._dialect.options))

    async def run(
        self, name: str, observe: Callable[[], Awaitable[Any]] | None, inputs: Mapping[str, Any]
    ) -> CalibrationResult:
        """Run a step and store the options that it determines."""
        step = calibration_step(self._dialect, name)
        with self._runner.command() as op:
            operation = step.operation(op, **inputs)
            result = await (self._run_motion(op, operation) if step.moves else self._runner.run(operation))
            if step.observation_question is not None and observe is not None:
                observed = await observe()
                result = replace(result, options={} if observed is None else step.options_observed(observed))
            for option, value in result.options.items():
                await self._save(option, value)
        return result

    async def _run_motion(
        self, op: OperationContext, operation: DriveOperation[CalibrationResult]
    ) -> CalibrationResult:
        with self._stops.stop_on_failure(op):
            result = await self._stops.run_motion(operation)
            if result.outcome is not None:
                raise_for_status(result.outcome)
        return result

    async def _save(self, option: str, value: Any) -> None:
        self._dialect.set_option(option, value)
        await asyncio.to_thread(self._store.put, self._key(option), json.dumps(value))

    def _key(self, option: str) -> str:
        profile = self._dialect.profile
        return (
            f"calibration/{drive_key(self._runner.bus.port.identity, self._dialect.address)}/{profile.model}/{option}"
        )

    def load(self) -> None:
        """Apply the stored options. A record or file that can't be read determines nothing, and prevents no stop.

        So does a value that the option can't have: none of them may lift the cap of what is not determined.
        """
        for option in self._dialect.profile.options:
            text = value_if_readable(self._store, self._key(option))
            if text is None or option in self._explicit_options:
                continue
            try:
                value = json.loads(text)
            except (ValueError, RecursionError):
                continue
            if self._dialect.profile.question(option).allows(value):
                self._dialect.set_option(option, value)
