"""What became of one drive: which frames it heard, who switched its motor on, and what hands and chance did to it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any

from drivebus.lab.manual import Does
from drivebus.lab.world.conduct import LOOKS, Frame
from drivebus.lab.world.wishes import Wish

HAND_STOPS = frozenset({"press_stop", "power_cycle", "trip"})
HANDS = ("press_run", "press_set", *sorted(HAND_STOPS))
"""What happens to a station without a frame, and what of it takes the motor off."""
REMEMBERED = 32


class Deeds:
    """Watches one station beside the witness; times are the line's."""

    def __init__(self, station: Any, now: Callable[[], float], note: Callable[[str], None]) -> None:
        self.station, self._now, self._note = station, now, note
        self.stop_heard_at = self.on_at = self.hand_at = self.hand_stop_at = -inf
        """When a stop was heard, the motor was switched on, and something happened (or stopped it) without a frame."""
        self.reads = 0
        """Reads that it heard since something stopped it without a frame."""
        self.on_for: Wish | None = None
        """The wish that the motor is on for; None: a person at its keypad."""
        self.wishes: deque[Wish] = deque(maxlen=REMEMBERED)
        """The last ones, over or not."""
        for name in HANDS:
            setattr(station, name, self._by_hand(name, getattr(station, name)))

    def _by_hand(self, name: str, deed: Callable[..., None]) -> Callable[..., None]:
        def done(*arguments: Any, **named: Any) -> None:
            was_on = self.station.motor.energised
            deed(*arguments, **named)
            self.hand_at = self._now()
            if name in HAND_STOPS:
                self.hand_stop_at, self.reads = self.hand_at, 0
            self._note(f"! {name} {self.station.address}")
            if self.station.motor.energised and not was_on:
                self.switched_on(None)

        return done

    def wished(self, wish: Wish) -> None:
        self.wishes.append(wish)

    def heard(self, frame: Frame) -> None:
        """The drive got this frame, whatever it makes of it."""
        self.reads += frame.does is Does.READ
        if frame.does is Does.STOP:
            self.stop_heard_at = self._now()
        elif frame.wish is not None:
            frame.wish.heard += 1
            frame.wish.moves_heard += frame.does is Does.MOVE

    @property
    def stood_unseen(self) -> bool:
        """By hand or by chance it stopped before anybody saw it run, and two reads behind fences found it standing."""
        return self.hand_stop_at > self.on_at and self.reads >= LOOKS

    def switched_on(self, wish: Wish | None) -> None:
        self.on_at, self.on_for = self._now(), wish

    def alone(self, wish: Wish) -> bool:
        """Nobody else wished anything of this drive, and nothing happened to it, while this went on."""
        others = (one for one in self.wishes if one is not wish)
        overlap = any(one.ended_at is None or one.ended_at >= wish.at for one in others)
        return not overlap and self.hand_at < wish.at

    @property
    def on(self) -> bool:
        return bool(self.station.motor.energised)
