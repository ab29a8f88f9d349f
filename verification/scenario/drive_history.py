"""What became of one drive: which frames it heard, who switched its motor on, and what hands and chance did to it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any

from verification.reference.request_effects import RequestEffect
from verification.scenario.frame_rules import STATUS_READS_BETWEEN_STARTS, ClassifiedFrame
from verification.scenario.user_command import UserCommand

LOCAL_STOP_ACTIONS = frozenset({"keypad_stop", "power_cycle", "trip"})
LOCAL_ACTIONS = ("keypad_run", "keypad_set", *sorted(LOCAL_STOP_ACTIONS))
"""What happens to a station without a frame, and what of it takes the motor off."""
MAX_REMEMBERED_COMMANDS = 32


class DriveHistory:
    """Watches one station beside the witness; times are the line's."""

    def __init__(self, station: Any, now: Callable[[], float], note: Callable[[str], None]) -> None:
        self.station, self._now, self._note = station, now, note
        self.stop_received_at = self.on_at = self.local_action_at = self.local_stop_at = -inf
        """When a stop was heard, the motor was switched on, and something happened (or stopped it) without a frame."""
        self.reads = 0
        """Reads that it heard since something stopped it without a frame."""
        self.started_for: UserCommand | None = None
        """The wish that the motor is on for; None: a person at its keypad."""
        self.commands: deque[UserCommand] = deque(maxlen=MAX_REMEMBERED_COMMANDS)
        """The last ones, over or not."""
        for name in LOCAL_ACTIONS:
            setattr(station, name, self._record_local_action(name, getattr(station, name)))

    def _record_local_action(self, name: str, deed: Callable[..., None]) -> Callable[..., None]:
        def done(*arguments: Any, **named: Any) -> None:
            was_on = self.station.motor.energised
            deed(*arguments, **named)
            self.local_action_at = self._now()
            if name in LOCAL_STOP_ACTIONS:
                self.local_stop_at, self.reads = self.local_action_at, 0
            self._note(f"! {name} {self.station.address}")
            if self.station.motor.energised and not was_on:
                self.on_motor_started(None)

        return done

    def on_command(self, wish: UserCommand) -> None:
        self.commands.append(wish)

    def on_frame(self, frame: ClassifiedFrame) -> None:
        """The drive got this frame, whatever it makes of it."""
        self.reads += frame.effect is RequestEffect.READ
        if frame.effect is RequestEffect.STOP:
            self.stop_received_at = self._now()
        elif frame.user_command is not None:
            frame.user_command.frames_received += 1
            frame.user_command.motion_frames_received += frame.effect is RequestEffect.MOTION

    @property
    def stopped_unobserved(self) -> bool:
        """By hand or by chance it stopped before anybody saw it run, and two reads behind fences found it standing."""
        return self.local_stop_at > self.on_at and self.reads >= STATUS_READS_BETWEEN_STARTS

    def on_motor_started(self, wish: UserCommand | None) -> None:
        self.on_at, self.started_for = self._now(), wish

    def is_undisturbed(self, wish: UserCommand) -> bool:
        """Nobody else wished anything of this drive, and nothing happened to it, while this went on."""
        others = (one for one in self.commands if one is not wish)
        overlap = any(one.ended_at is None or one.ended_at >= wish.at for one in others)
        return not overlap and self.local_action_at < wish.at

    @property
    def on(self) -> bool:
        return bool(self.station.motor.energised)
