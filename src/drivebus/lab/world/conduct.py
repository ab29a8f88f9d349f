"""Holds every frame of the host against I1, I2, I3, I6, I7 and I10. Knows times, bytes and wishes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import inf

from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does
from drivebus.lab.world.wishes import Wish

TOLERANCE_S = 1e-9
PREPARE_S = 5.0
"""From the wish to the command object: the checks before a start may take so long (operation's own promise)."""
EXPIRY_S = 2.0
"""From the command object to the first bit of a frame that moves (ruling 12)."""
MOST_PATIENCE_S = 0.1
LOOKS = 4
"""Ruling 6: two reads, each behind a fence of its own, before a start is sent again."""


class Frame:
    """Something that a host said, and what it means by the manual."""

    __slots__ = ("address", "does", "end", "start", "wish")

    def __init__(self, start: float, end: float, address: int, does: Does, wish: Wish | None = None) -> None:
        self.start, self.end, self.address, self.does, self.wish = start, end, address, does, wish


class Conduct:
    """What a host may say, and when."""

    def __init__(self, kind: Kind, character_s: float, violation: Callable[[str], None]) -> None:
        self._broadcast, self._tells = kind.broadcast, kind.tells
        self._violation = violation
        self._gap_s = max(kind.gap_characters * character_s, kind.gap_floor_s)
        self._patience_s = min(kind.patience_s + kind.patience_characters * character_s, MOST_PATIENCE_S)
        self.misled = False
        """What is heard by our own last bit, or our own frame, may pass for a spoiled answer: the echo is set wrong or
        comes in batches, or the port has no pacing. Then the host may give up as soon as it has heard it."""
        self._last: Frame | None = None
        self._stop_due: float | None = None
        self._stop_at: dict[int, float] = {}
        self._lost_at = -inf
        self._wished: set[int] = set()
        self._started: dict[int, Wish] = {}
        """Whose start left last, by address …"""
        self._looks: Counter[int] = Counter()
        """… and how often that drive was asked since."""
        self._jogged: set[int] = set()
        """VC660 jogs by a level: the levels at rest are then the stop itself, until one of them was answered."""

    def stop_wished(self, wish: Wish, can_speak: bool) -> None:
        """From now on the next frame must be a stop; where the port is lost there is none that could come next."""
        self._wished.add(wish.address)
        self._stop_at[wish.address] = wish.at
        if self._stop_due is None and can_speak:
            self._stop_due = wish.at

    def lost(self, now: float) -> None:
        """The port is gone, and with it every command that was made before."""
        self._lost_at = now
        self._stop_due = None

    def asked(self, frame: Frame, heard_end: float, answered: bool) -> None:
        """``heard_end``: the last bit that the host heard; ``answered``: a reply ended since the last request."""
        if self._last is not None:
            self._timing(frame, self._last, heard_end, answered)
            if answered and self._last.does in (Does.STOP, Does.REST):
                self._jogged.discard(self._last.address)
        self._last = frame
        if frame.does is Does.STOP or (frame.does is Does.REST and frame.address in self._jogged):
            self._stop_due = None
            self._wished.add(frame.address)  # VC660: the levels without the pulse complete it, also a broadcast one
            return
        if self._stop_due is not None and frame.start > self._stop_due + TOLERANCE_S:
            self._violation(f"I3 {frame.does} to {frame.address} went before a stop wished at {self._stop_due:.6f}")
        if frame.does is not Does.READ:
            self._rights(frame)
        else:
            self._looks[frame.address] += 1

    def _timing(self, frame: Frame, last: Frame, heard_end: float, answered: bool) -> None:
        """I6: one request outstanding, and the gap before each."""
        since = frame.start - last.end
        if since < self._gap_s - TOLERANCE_S:
            self._violation(f"I6 {since:.6f} s after our own frame")
        if frame.start - heard_end < self._gap_s - TOLERANCE_S and frame.does is not Does.STOP:
            self._violation(f"I6 {frame.start - heard_end:.6f} s after a reply")
        patient = answered or self.misled or self._lost_at >= last.start or since >= self._patience_s - TOLERANCE_S
        if not patient:
            self._violation(f"I6 spoke {since:.6f} s after a request that was neither answered nor given up")

    def _rights(self, frame: Frame) -> None:
        what, wish = f"{frame.does} to {frame.address}", frame.wish
        if frame.address == self._broadcast and frame.does is not Does.REST:
            self._violation(f"I7 {what}: a broadcast")
        elif frame.does is Does.REST:
            if frame.address not in self._wished:
                self._violation(f"I1 {what} without a wish")
        elif wish is None:
            self._violation(f"I1 {what} without a wish")
        else:
            self._wished.add(frame.address)
            if wish.what == "jog":
                self._jogged.add(frame.address)
            self._wish(frame, wish, what)

    def _wish(self, frame: Frame, wish: Wish, what: str) -> None:
        if frame.does is Does.MOVE and frame.start - wish.at > PREPARE_S + EXPIRY_S + 0.1:
            self._violation(f"I1 {what} {frame.start - wish.at:.3f} s after {wish}")
        if self._stop_at.get(frame.address, -inf) > wish.at and wish.what != "write":  # 6.5 names start, setpoint, jog
            self._violation(f"I1 {what} for {wish}, after a newer stop")
        if self._lost_at > wish.at:
            self._violation(f"I10 {what} for {wish}, which is older than the port")
        if frame.does is Does.MOVE and wish.what == "run":
            self._start(frame.address, wish)

    def _start(self, address: int, wish: Wish) -> None:
        """I2: never twice, unless a drive that can tell was looked at in between."""
        looks = self._looks[address] if self._tells else 0
        if self._started.get(address) is wish and looks < LOOKS:
            self._violation(f"I2 {wish} was sent again after {self._looks[address]} looks")
        self._started[address], self._looks[address] = wish, 0
