"""One state of the gate campaign: a real bus core, a command, a permit, the witness. It can be copied and named."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from drivebus.bus.core import BusCore
from drivebus.bus.messages import Permit
from drivebus.drives.permissives import DriveCommand
from verification.model_check import core_copy as gate_copy
from verification.model_check.model_subject import OUR_ADDRESS, ModelSubject
from verification.model_check.permit_monitor import ModelCommand, PermitMonitor, PermitRecord
from verification.model_check.time_grid import FINE_STEP_S, GRID_START_S, grid_serial_settings
from verification.reference.request_effects import RequestEffect

FIRST_FORGED_SLOT = 8
"""Slots from here on are of asks that nobody granted."""


@dataclass(slots=True)
class TransitionEvents:
    """What one event brought about."""

    motion_frames: int = 0
    setting_frames: int = 0
    findings: list[str] = field(default_factory=list)
    refused: list[tuple[str, ...]] = field(default_factory=list)
    """What was missing for each frame that the bus refused."""
    denied: list[tuple[str, ...]] = field(default_factory=list)
    """What was missing for each permit that the gate refused."""


@dataclass(slots=True)
class HeldPermit:
    """A permit that somebody holds, and may use now, later, or twice."""

    permit: Permit
    record: PermitRecord
    place: int


class ModelState:
    """Mutable; ``copy`` before each event."""

    __slots__ = (
        "_owns_core",
        "_sequence_started",
        "alarm",
        "command",
        "core",
        "events",
        "held_permit",
        "model_command",
        "monitor",
        "now",
        "permits",
        "shadow",
        "subject",
    )

    def __init__(self, subject: ModelSubject) -> None:
        self.subject = subject
        self.core = BusCore(grid_serial_settings(subject.grid), echo="off")
        self.core.add_station(subject.dialect.station_config)
        self.monitor = PermitMonitor(subject.model)
        self.now = GRID_START_S
        self.alarm: float | None = None
        self.command: DriveCommand | None = None
        self.model_command: ModelCommand | None = None
        self.held_permit: HeldPermit | None = None
        self.permits: dict[int, PermitRecord] = {}
        self.shadow = subject.command_word
        self.events = TransitionEvents()
        self._sequence_started = False
        """The first of the command's frames has left: the others may follow."""
        self._owns_core = True

    def copy(self) -> Self:
        """The core is shared until something happens to it: whoever looks and waits changes nothing."""
        made = object.__new__(type(self))
        made.subject, made.core, made.now, made.alarm, made._owns_core = (
            self.subject,
            self.core,
            self.now,
            self.alarm,
            False,
        )
        made._sequence_started = self._sequence_started
        made.command, made.model_command, made.held_permit, made.shadow = (
            self.command,
            self.model_command,
            self.held_permit,
            self.shadow,
        )
        made.permits, made.monitor, made.events = dict(self.permits), self.monitor.copy(), TransitionEvents()
        return made

    def _own_core(self) -> BusCore:
        """The core, to do something to it."""
        if not self._owns_core:
            self.core, self._owns_core = gate_copy.copy_core(self.core), True
        return self.core

    # --- the state's name --------------------------------------------------------------------------------------

    def state_key(self) -> tuple[Any, ...]:
        """Equal for states from which the same can happen."""
        far_s = self.subject.limit_s(RequestEffect.SETTING) + 1.0
        return (
            gate_copy.state_key(self.core, self.now, far_s),
            self.command_key(),
            self.held_permit_key(),
            [(slot, *self._permit_key(leave)) for slot, leave in sorted(self.permits.items())],
            self.shadow,
            self._sequence_started,
            self.monitor.command_word & 4,
            self.now % self.subject.grid.tick_s,
        )

    @property
    def generation(self) -> int:
        station = self.core.stations.get(OUR_ADDRESS)
        return (station or self.core.removed_stations[OUR_ADDRESS]).stop_epoch

    def command_key(self) -> tuple[Any, ...] | None:
        if self.command is None or self.model_command is None:
            return None
        reason = _reason(self.monitor.counts.missing_since(self.model_command.counts))
        age_s = min(self.now - self.command.created_at, self.subject.limit_s(RequestEffect.SETTING) + FINE_STEP_S)
        return self.command.stop_epoch == self.generation, reason, 0.0 if reason else age_s

    def held_permit_key(self) -> tuple[Any, ...] | None:
        held = self.held_permit
        if held is None:
            return None
        same = held.permit.stop_epoch == self.generation
        return held.place, same, *self._permit_key(held.record)

    def _permit_key(self, leave: PermitRecord) -> tuple[Any, ...]:
        """Of what is void it does not matter for how long; what moves and was sent has had its turn."""
        if leave.frames_sent and leave.effect is RequestEffect.MOTION:
            return ("sent", leave.data)
        reason = _reason(self.monitor.counts.missing_since(leave.counts))
        left_s = max(leave.expires_at - self.now, -FINE_STEP_S)
        return 0.0 if reason else left_s, reason, leave.missing, leave.frames_sent, leave.data

    @property
    def check_forged_refused(self) -> bool:
        """Something that nobody granted was let in."""
        return any(slot >= FIRST_FORGED_SLOT for slot in self.permits)


def _reason(lacks: tuple[str, ...]) -> str:
    return lacks[0] if len(lacks) == 1 else "many" if lacks else ""
