"""Monitor of permits: records what was done to the bus, without access to the bus.

A frame that acts may be sent only for a command of which no condition is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from verification.families.modbus.facts import command_word
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import worst_effect

COMMAND_LIFETIMES_S = {"start": 2.0, "jog": 2.0, "reset": 2.0, "setpoint": 5.0, "pause": 5.0, "ramp_hold": 2.0}
"""Validity of a command by its kind, in seconds; a frame that moves the motor is valid for 2 s at most."""
EVIDENCE_MAX_AGE_S = 2.0
FAMILY_DAMAGE_RATE_MAX = {"dzb100": 0.001}
DAMAGE_RATE_MAX, DAMAGE_COUNT_MIN = 0.01, 3
"""Largest share of damaged replies (0.1 % without a checksum, 1 % elsewhere), and the smallest count that is a rate."""


@dataclass(frozen=True, slots=True)
class EventCounts:
    """Numbers of the events that invalidate earlier commands."""

    stops: int = 0
    losses: int = 0
    removals: int = 0

    def missing_since(self, then: EventCounts) -> tuple[str, ...]:
        """Return the conditions that a command of ``then`` has lost."""
        if self is then:
            return ()
        found = ("no newer stop",) * (self.stops != then.stops) + ("port held",) * (self.losses != then.losses)
        return found + ("station kept",) * (self.removals != then.removals)


@dataclass(frozen=True, slots=True)
class ModelCommand:
    """Command as the monitor knows it: its time and the event counts at that time."""

    made_at: float
    counts: EventCounts


@dataclass(frozen=True, slots=True, kw_only=True)
class PermitRecord:
    """Permit as the monitor knows it: its bytes, effect and expiry; ``missing``: conditions missing when it was
    granted."""

    data: bytes
    effect: RequestEffect
    expires_at: float
    counts: EventCounts
    missing: tuple[str, ...] = ()
    frames_sent: int = 0


@dataclass(slots=True, kw_only=True)
class PermitMonitor:
    """Monitor of one station."""

    model: str
    counts: EventCounts = EventCounts()
    start_inhibited: bool = False
    is_open: bool = False
    present: bool = True
    command_word: int = 0
    """Last word sent to the drive (VC660)."""

    def copy(self) -> PermitMonitor:
        return PermitMonitor(
            model=self.model,
            counts=self.counts,
            start_inhibited=self.start_inhibited,
            is_open=self.is_open,
            present=self.present,
            command_word=self.command_word,
        )

    def effect_of(self, data: bytes) -> RequestEffect:
        return worst_effect(self.model, data, self.command_word)

    def on_stop(self) -> None:
        self.counts = replace(self.counts, stops=self.counts.stops + 1)

    def on_port_lost(self) -> None:
        self.counts, self.is_open = replace(self.counts, losses=self.counts.losses + 1), False

    def on_removed(self) -> None:
        self.counts, self.present = replace(self.counts, removals=self.counts.removals + 1), False

    def missing_for_frame(self, record: PermitRecord, now: float) -> tuple[str, ...]:
        """Return the conditions that are missing now for the first bit of this frame."""
        found = [*record.missing, *self.counts.missing_since(record.counts)]
        found += ["unexpired"] * (now > record.expires_at) + ["no start inhibit"] * (
            self.start_inhibited and record.effect is RequestEffect.MOTION
        )
        found += ["port open"] * (not self.is_open) + ["station known"] * (not self.present)
        found += ["sent once"] * (record.frames_sent > 0 and record.effect is RequestEffect.MOTION)
        return tuple(dict.fromkeys(found))

    def missing_for_permit(self, command: ModelCommand, limit_s: float, now: float) -> tuple[str, ...]:
        """Return the conditions of command and station that are missing for a permit."""
        expired = ("unexpired",) if now > command.made_at + limit_s else ()
        return (
            self.counts.missing_since(command.counts)
            + expired
            + (("no start inhibit",) if self.start_inhibited else ())
        )

    def on_frame_sent(
        self, data: bytes, records: dict[int, PermitRecord], now: float
    ) -> tuple[RequestEffect, int | None, tuple[str, ...]]:
        """Return the effect of a sent frame, its slot, and the missing conditions."""
        effect = self.effect_of(data)
        if self.model == "vc660" and (word := command_word(data)) is not None:
            self.command_word = word
        if effect in (RequestEffect.READ, RequestEffect.STOP):
            return effect, None, ()
        matching = {
            slot: self.missing_for_frame(record, now) for slot, record in records.items() if record.data == data
        }
        if not matching:
            return effect, None, ("command",)
        slot = min(matching, key=lambda candidate: (len(matching[candidate]), candidate))
        return effect, slot, matching[slot]
