"""One state of the gate campaign: a real bus core, a command, a permit, the witness. It can be copied and named."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from drivebus.bus.core import BusCore
from drivebus.drives.gate import Command
from drivebus.lab.gate import copy as gate_copy
from drivebus.lab.gate.bytes import Act
from drivebus.lab.gate.grid import BEGIN_S, JUST_S, line_of
from drivebus.lab.gate.monitor import Leave, Monitor, Wish
from drivebus.lab.gate.subject import OURS, Subject
from drivebus.message import Permit

FORGED = 8
"""Slots from here on are of asks that nobody granted."""


@dataclass(slots=True)
class Seen:
    """What one event brought about."""

    moved: int = 0
    acted: int = 0
    bad: list[str] = field(default_factory=list)
    refused: list[tuple[str, ...]] = field(default_factory=list)
    """What was missing for each frame that the bus refused."""
    denied: list[tuple[str, ...]] = field(default_factory=list)
    """What was missing for each permit that the gate refused."""


@dataclass(slots=True)
class Held:
    """A permit that somebody holds, and may use now, later, or twice."""

    permit: Permit
    leave: Leave
    place: int


class State:
    """Mutable; ``copy`` before each event."""

    __slots__ = (
        "_begun",
        "_ours",
        "alarm",
        "command",
        "core",
        "held",
        "leaves",
        "monitor",
        "now",
        "seen",
        "shadow",
        "subject",
        "wish",
    )

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.core = BusCore(line_of(subject.grid), echo="off")
        self.core.add(subject.dialect.link)
        self.monitor = Monitor(subject.model)
        self.now = BEGIN_S
        self.alarm: float | None = None
        self.command: Command | None = None
        self.wish: Wish | None = None
        self.held: Held | None = None
        self.leaves: dict[int, Leave] = {}
        self.shadow = subject.shadow
        self.seen = Seen()
        self._begun = False
        """The first of the command's frames has left: the others may follow."""
        self._ours = True

    def copy(self) -> Self:
        """The core is shared until something happens to it: whoever looks and waits changes nothing."""
        made = object.__new__(type(self))
        made.subject, made.core, made.now, made.alarm, made._ours = self.subject, self.core, self.now, self.alarm, False
        made._begun = self._begun
        made.command, made.wish, made.held, made.shadow = self.command, self.wish, self.held, self.shadow
        made.leaves, made.monitor, made.seen = dict(self.leaves), self.monitor.copy(), Seen()
        return made

    def _touched(self) -> BusCore:
        """The core, to do something to it."""
        if not self._ours:
            self.core, self._ours = gate_copy.copy(self.core), True
        return self.core

    # --- the state's name --------------------------------------------------------------------------------------

    def name(self) -> tuple[Any, ...]:
        """Equal for states from which the same can happen."""
        far_s = self.subject.limit_s(Act.SETS) + 1.0
        return (
            gate_copy.name(self.core, self.now, far_s), self.command_name(), self.held_name(),
            [(slot, *self._leave_name(leave)) for slot, leave in sorted(self.leaves.items())],
            self.shadow, self._begun, self.monitor.held & 4, self.now % self.subject.grid.tick_s,
        )  # fmt: skip

    @property
    def generation(self) -> int:
        station = self.core.stations.get(OURS)
        return (station or self.core.gone[OURS]).generation

    def command_name(self) -> tuple[Any, ...] | None:
        if self.command is None or self.wish is None:
            return None
        reason = _reason(self.monitor.epoch.since(self.wish.epoch))
        age_s = min(self.now - self.command.created_at, self.subject.limit_s(Act.SETS) + JUST_S)
        return self.command.generation == self.generation, reason, 0.0 if reason else age_s

    def held_name(self) -> tuple[Any, ...] | None:
        held = self.held
        if held is None:
            return None
        same = held.permit.generation == self.generation
        return held.place, same, *self._leave_name(held.leave)

    def _leave_name(self, leave: Leave) -> tuple[Any, ...]:
        """Of what is void it does not matter for how long; what moves and was sent has had its turn."""
        if leave.sent and leave.act is Act.MOVES:
            return ("sent", leave.data)
        reason = _reason(self.monitor.epoch.since(leave.epoch))
        left_s = max(leave.until - self.now, -JUST_S)
        return 0.0 if reason else left_s, reason, leave.lacks, leave.sent, leave.data

    @property
    def forged(self) -> bool:
        """Something that nobody granted was let in."""
        return any(slot >= FORGED for slot in self.leaves)


def _reason(lacks: tuple[str, ...]) -> str:
    return lacks[0] if len(lacks) == 1 else "many" if lacks else ""
