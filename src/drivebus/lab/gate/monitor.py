"""The witness of the gate campaign: what was done to the bus and when, in its own books. It never looks into the bus.

A frame that acts may leave only where a wish stands for it of which nothing is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from drivebus.lab.gate.bytes import READERS, Act, word_of

LIVES_S = {"start": 2.0, "jog": 2.0, "reset": 2.0, "setpoint": 5.0}
"""Ruling 12: what a person wished for longer ago is another wish. What moves lives 2 s, whatever it was meant as."""
FRESH_S = 2.0
FAMILY_RATE = {"dzb100": 0.001}
RATE, FEWEST = 0.01, 3
"""RELIABILITY 4: 0.1 % damaged answers where nothing detects a flipped bit, 1 % elsewhere; one or two are no rate."""


@dataclass(frozen=True, slots=True)
class Epoch:
    """How often each thing has happened that voids what was wished for before."""

    stops: int = 0
    losses: int = 0
    removals: int = 0

    def since(self, then: Epoch) -> tuple[str, ...]:
        """Names of what is missing for a wish of ``then``."""
        if self is then:
            return ()
        found = ("no newer stop",) * (self.stops != then.stops) + ("port held",) * (self.losses != then.losses)
        return found + ("station kept",) * (self.removals != then.removals)


@dataclass(frozen=True, slots=True)
class Wish:
    """A command as its maker knows it: when it was made, and what else had happened by then."""

    made_at: float
    epoch: Epoch


@dataclass(frozen=True, slots=True)
class Leave:
    """A permit as its owner knows it: for these bytes and this wish; ``lacks``: what was missing at its grant."""

    data: bytes
    act: Act
    until: float
    epoch: Epoch
    lacks: tuple[str, ...] = ()
    sent: int = 0


@dataclass(slots=True)
class Monitor:
    """One station's story."""

    model: str
    epoch: Epoch = Epoch()
    latched: bool = False
    is_open: bool = False
    present: bool = True
    held: int = 0
    """The word that the drive was sent last (VC660)."""

    def copy(self) -> Monitor:
        return Monitor(self.model, self.epoch, self.latched, self.is_open, self.present, self.held)

    def act_of(self, data: bytes) -> Act:
        return READERS[self.model](data, self.held)

    def stopped(self) -> None:
        self.epoch = replace(self.epoch, stops=self.epoch.stops + 1)

    def lost(self) -> None:
        self.epoch, self.is_open = replace(self.epoch, losses=self.epoch.losses + 1), False

    def removed(self) -> None:
        self.epoch, self.present = replace(self.epoch, removals=self.epoch.removals + 1), False

    def lacks(self, leave: Leave, now: float) -> tuple[str, ...]:
        """What is missing at this instant for the first bit of this frame."""
        found = [*leave.lacks, *self.epoch.since(leave.epoch)]
        found += ["unexpired"] * (now > leave.until) + ["not latched"] * (self.latched and leave.act is Act.MOVES)
        found += ["port open"] * (not self.is_open) + ["station known"] * (not self.present)
        found += ["sent once"] * (leave.sent > 0 and leave.act is Act.MOVES)
        return tuple(dict.fromkeys(found))

    def wish_lacks(self, wish: Wish, limit_s: float, now: float) -> tuple[str, ...]:
        """What is missing for a permit, as far as the wish and the station go."""
        gone = ("unexpired",) if now > wish.made_at + limit_s else ()
        return self.epoch.since(wish.epoch) + gone + (("not latched",) if self.latched else ())

    def left(self, data: bytes, leaves: dict[int, Leave], now: float) -> tuple[Act, int | None, tuple[str, ...]]:
        """A frame leaves: what it does, the wish that it is for, and what is missing; () where all is there."""
        act = self.act_of(data)
        self.held = word if (word := word_of(data)) is not None and self.model == "vc660" else self.held
        if act in (Act.READS, Act.STOPS):
            return act, None, ()
        mine = {slot: self.lacks(leave, now) for slot, leave in leaves.items() if leave.data == data}
        if not mine:
            return act, None, ("wish",)
        slot = min(mine, key=lambda one: (len(mine[one]), one))
        return act, slot, mine[slot]
