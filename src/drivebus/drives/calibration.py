"""Undocumented options of one drive that were determined on the bench, and their storage."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection
from typing import Any

from drivebus.drives.operations import calibration
from drivebus.drives.operations.calibration import ScalingResult
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.outcome import Outcome, raise_for_status
from drivebus.drives.runner import OperationRunner
from drivebus.drives.state import Direction
from drivebus.drives.stop_supervisor import StopSupervisor
from drivebus.drives.store import Store, drive_key


class Calibration:
    """Calibration of one drive: runs the bench procedures and stores what they determine."""

    def __init__(
        self, runner: OperationRunner, stops: StopSupervisor, store: Store, explicit_options: Collection[str]
    ) -> None:
        """``explicit_options``: options that the user gave; a stored value never replaces them."""
        self._runner, self._stops, self._store = runner, stops, store
        self._dialect = runner.drive.dialect
        self._explicit_options = explicit_options

    async def query_coding(self, keypad_hz: float) -> ScalingResult:
        """Determine the query coding of a DZB100 from Q00 while the keypad shows ``keypad_hz``; nothing moves."""
        found = await self._runner.run(
            calibration.calibrate_query_coding(OperationContext(self._runner.drive), keypad_hz)
        )
        if found.coding is not None:
            await self._save("query_coding", found.coding)
        return found

    async def setpoint_coding(self, direction: Direction | None) -> ScalingResult:
        """Determine the setpoint coding of a DZB100 by runs at 5 Hz or less."""
        op = self._runner.new_command()
        with self._stops.stop_on_failure(op):
            found = await self._stops.run_motion(calibration.calibrate_setpoint_coding(op, direction))
        if found.coding is not None:
            await self._save("setpoint_coding", found.coding)
        return found

    async def direction(self, frequency_hz: float, observe: Callable[[], Awaitable[Direction | None]]) -> Outcome:
        """Determine the direction field of a DF800 by one jog of 0.5 s, after which ``observe`` asks a person."""
        op = self._runner.new_command()
        with self._stops.stop_on_failure(op):
            outcome = raise_for_status(await self._stops.run_motion(calibration.calibration_jog(op, frequency_hz)))
        observed = await observe()
        if observed is not None:
            await self._save("direction_field", calibration.direction_field_for(observed))
            await self._save("direction_proved", True)
        return outcome

    async def _save(self, option: str, value: Any) -> None:
        self._dialect.set_option(option, value)
        await asyncio.to_thread(self._store.put, self._key(option), json.dumps(value))

    def _key(self, option: str) -> str:
        profile = self._dialect.profile
        return f"proof/{drive_key(self._runner.bus.port.identity, self._dialect.address)}/{profile.model}/{option}"

    def load(self) -> None:
        """Apply the stored options. A record that can't be read determines nothing."""
        for option in self._dialect.profile.settings:
            text = self._store.get(self._key(option))
            if text is None or option in self._explicit_options:
                continue
            try:
                value = json.loads(text)
            except ValueError:
                continue
            self._dialect.set_option(option, value)
