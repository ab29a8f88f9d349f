"""What a drive does by itself when its host falls silent: read from the drive where its manual tells how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import voice

if TYPE_CHECKING:
    from drivebus.drives import Drive
    from drivebus.profiles import DriveProfile


@dataclass(frozen=True, slots=True)
class CommLossFound:
    """The timer and the action as the drive has them; None where it can't be read or nobody published it."""

    model: str
    time_notation: str | None
    time_s: float | None
    action_notation: str | None
    action: int | None
    stops: bool | None
    """True: the drive stops by itself; False: it keeps running; None: unknown."""

    def as_document(self) -> dict[str, Any]:
        verdict = {True: "stops", False: "keeps_running", None: "unknown"}[self.stops]
        return {
            "time": {"notation": self.time_notation, "value_s": self.time_s},
            "action": {"notation": self.action_notation, "raw": self.action},
            "verdict": verdict,
            "text": self.text(),
        }

    def text(self) -> str:
        """One sentence for the person who is about to leave."""
        if self.time_notation is None:
            return voice.say("run.comm_loss.unpublished", model=self.model)
        key = {True: "stops", False: "keeps_running", None: "unknown"}[self.stops]
        if self.time_s == 0:
            key = "off"
        return voice.say(
            f"run.comm_loss.{key}",
            time=self.time_notation,
            seconds="?" if self.time_s is None else f"{self.time_s:g}",
            action=self.action_notation or "?",
            value="?" if self.action is None else self.action,
        )


async def read_comm_loss(profile: DriveProfile, drive: Drive) -> CommLossFound:
    """Read the timer and its action."""
    rule = profile.comm_loss
    time_s = await _value(drive, rule.time_notation)
    action = await _value(drive, rule.action_notation, raw=True)
    number = None if action is None else int(action)
    stops = None if number is None or not rule.trips_values else number in rule.trips_values
    if time_s == 0:
        stops = False
    return CommLossFound(profile.model, rule.time_notation, time_s, rule.action_notation, number, stops)


async def _value(drive: Drive, notation: str | None, raw: bool = False) -> float | None:
    if notation is None:
        return None
    reading = (await drive.read([notation]))[notation]
    value = reading.raw if raw else reading.value
    return float(value) if isinstance(value, int | float) else None
