"""The witness of the gate campaign: what was done to the bus and when, in its own books. It never looks into the bus.

A frame that acts may leave only where a wish stands for it of which nothing is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from verification.reference.request_effects import RequestEffect, command_word, worst_effect

COMMAND_LIFETIMES_S = {"start": 2.0, "jog": 2.0, "reset": 2.0, "setpoint": 5.0}
"""What a person wished for longer ago is another wish. What moves lives 2 s, whatever it was meant as."""
EVIDENCE_MAX_AGE_S = 2.0
FAMILY_DAMAGE_RATE_MAX = {"dzb100": 0.001}
DAMAGE_RATE_MAX, DAMAGE_COUNT_MIN = 0.01, 3
"""RELIABILITY 4: 0.1 % damaged answers where nothing detects a flipped bit, 1 % elsewhere; one or two are no rate."""


@dataclass(frozen=True, slots=True)
class EventCounts:
    """How often each thing has happened that voids what was wished for before."""

    stops: int = 0
    losses: int = 0
    removals: int = 0

    def missing_since(self, then: EventCounts) -> tuple[str, ...]:
        """Names of what is missing for a wish of ``then``."""
        if self is then:
            return ()
        found = ("no newer stop",) * (self.stops != then.stops) + ("port held",) * (self.losses != then.losses)
        return found + ("station kept",) * (self.removals != then.removals)


@dataclass(frozen=True, slots=True)
class ModelCommand:
    """A command as its maker knows it: when it was made, and what else had happened by then."""

    made_at: float
    counts: EventCounts


@dataclass(frozen=True, slots=True)
class PermitRecord:
    """A permit as its owner knows it: for these bytes and this wish; ``lacks``: what was missing at its grant."""

    data: bytes
    effect: RequestEffect
    expires_at: float
    counts: EventCounts
    missing: tuple[str, ...] = ()
    frames_sent: int = 0


@dataclass(slots=True)
class PermitMonitor:
    """One station's story."""

    model: str
    counts: EventCounts = EventCounts()
    latched: bool = False
    is_open: bool = False
    present: bool = True
    command_word: int = 0
    """The word that the drive was sent last (VC660)."""

    def copy(self) -> PermitMonitor:
        return PermitMonitor(self.model, self.counts, self.latched, self.is_open, self.present, self.command_word)

    def effect_of(self, data: bytes) -> RequestEffect:
        return worst_effect(self.model, data, self.command_word)

    def on_stop(self) -> None:
        self.counts = replace(self.counts, stops=self.counts.stops + 1)

    def on_port_lost(self) -> None:
        self.counts, self.is_open = replace(self.counts, losses=self.counts.losses + 1), False

    def on_removed(self) -> None:
        self.counts, self.present = replace(self.counts, removals=self.counts.removals + 1), False

    def missing_for_frame(self, leave: PermitRecord, now: float) -> tuple[str, ...]:
        """What is missing at this instant for the first bit of this frame."""
        found = [*leave.missing, *self.counts.missing_since(leave.counts)]
        found += ["unexpired"] * (now > leave.expires_at) + ["not latched"] * (
            self.latched and leave.effect is RequestEffect.MOTION
        )
        found += ["port open"] * (not self.is_open) + ["station known"] * (not self.present)
        found += ["sent once"] * (leave.frames_sent > 0 and leave.effect is RequestEffect.MOTION)
        return tuple(dict.fromkeys(found))

    def missing_for_permit(self, wish: ModelCommand, limit_s: float, now: float) -> tuple[str, ...]:
        """What is missing for a permit, as far as the wish and the station go."""
        gone = ("unexpired",) if now > wish.made_at + limit_s else ()
        return self.counts.missing_since(wish.counts) + gone + (("not latched",) if self.latched else ())

    def on_frame_sent(
        self, data: bytes, leaves: dict[int, PermitRecord], now: float
    ) -> tuple[RequestEffect, int | None, tuple[str, ...]]:
        """A frame leaves: what it does, the wish that it is for, and what is missing; () where all is there."""
        act = self.effect_of(data)
        self.command_word = (
            word if (word := command_word(data)) is not None and self.model == "vc660" else self.command_word
        )
        if act in (RequestEffect.READ, RequestEffect.STOP):
            return act, None, ()
        mine = {slot: self.missing_for_frame(leave, now) for slot, leave in leaves.items() if leave.data == data}
        if not mine:
            return act, None, ("wish",)
        slot = min(mine, key=lambda one: (len(mine[one]), one))
        return act, slot, mine[slot]
