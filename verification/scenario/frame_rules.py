"""Holds every frame of the host against I1, I2, I3, I6, I7 and I10. Knows times, bytes and wishes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import inf

from verification.drive_variants import DriveVariant
from verification.reference.request_effects import RequestEffect
from verification.scenario.user_command import UserCommand

TIME_EPSILON_S = 1e-9
PREPARATION_MAX_S = 5.0
"""From the wish to the command object: the checks before a start may take so long (operation's own promise)."""
COMMAND_EXPIRY_S = 2.0
"""From the command object to the first bit of a frame that moves."""
MIN_TIMEOUT_TOLERANCE_S = 0.1
STATUS_READS_BETWEEN_STARTS = 4
"""Two reads, each behind a fence of its own, before a start is sent again."""


class ClassifiedFrame:
    """Something that a host said, and what it means by the manual."""

    __slots__ = ("address", "effect", "end", "start", "user_command")

    def __init__(
        self, start: float, end: float, address: int, does: RequestEffect, wish: UserCommand | None = None
    ) -> None:
        self.start, self.end, self.address, self.effect, self.user_command = start, end, address, does, wish


class FrameRules:
    """What a host may say, and when."""

    def __init__(self, kind: DriveVariant, character_s: float, violation: Callable[[str], None]) -> None:
        self._broadcast, self._reports_running = kind.broadcast, kind.reports_running
        self._violation = violation
        self._gap_s = max(kind.gap_characters * character_s, kind.gap_floor_s)
        self._min_timeout_s = min(
            kind.min_timeout_s + kind.min_timeout_characters * character_s, MIN_TIMEOUT_TOLERANCE_S
        )
        self.misled_drives = False
        """What is heard by our own last bit, or our own frame, may pass for a spoiled answer: the echo is set wrong or
        comes in batches, or the port has no pacing. Then the host may give up as soon as it has heard it."""
        self._last: ClassifiedFrame | None = None
        self._stop_due: float | None = None
        self._stop_at: dict[int, float] = {}
        self._lost_at = -inf
        self._stop_commands: set[int] = set()
        self._started: dict[int, UserCommand] = {}
        """Whose start left last, by address …"""
        self._status_reads: Counter[int] = Counter()
        """… and how often that drive was asked since."""
        self._jogged: set[int] = set()
        """VC660 jogs by a level: the levels at rest are then the stop itself, until one of them was answered."""

    def on_stop_command(self, wish: UserCommand, can_speak: bool) -> None:
        """From now on the next frame must be a stop; where the port is lost there is none that could come next."""
        self._stop_commands.add(wish.address)
        self._stop_at[wish.address] = wish.at
        if self._stop_due is None and can_speak:
            self._stop_due = wish.at

    def on_port_lost(self, now: float) -> None:
        """The port is gone, and with it every command that was made before."""
        self._lost_at = now
        self._stop_due = None

    def on_request(self, frame: ClassifiedFrame, heard_end: float, answered: bool) -> None:
        """``heard_end``: the last bit that the host heard; ``answered``: a reply ended since the last request."""
        if self._last is not None:
            self._check_timing(frame, self._last, heard_end, answered)
            if answered and self._last.effect in (RequestEffect.STOP, RequestEffect.RELEASE):
                self._jogged.discard(self._last.address)
        self._last = frame
        if frame.effect is RequestEffect.STOP or (
            frame.effect is RequestEffect.RELEASE and frame.address in self._jogged
        ):
            self._stop_due = None
            self._stop_commands.add(
                frame.address
            )  # VC660: the levels without the pulse complete it, also a broadcast one
            return
        if self._stop_due is not None and frame.start > self._stop_due + TIME_EPSILON_S:
            self._violation(f"I3 {frame.effect} to {frame.address} went before a stop wished at {self._stop_due:.6f}")
        if frame.effect is not RequestEffect.READ:
            self._check_permission(frame)
        else:
            self._status_reads[frame.address] += 1

    def _check_timing(self, frame: ClassifiedFrame, last: ClassifiedFrame, heard_end: float, answered: bool) -> None:
        """I6: one request outstanding, and the gap before each."""
        since = frame.start - last.end
        if since < self._gap_s - TIME_EPSILON_S:
            self._violation(f"I6 {since:.6f} s after our own frame")
        if frame.start - heard_end < self._gap_s - TIME_EPSILON_S and frame.effect is not RequestEffect.STOP:
            self._violation(f"I6 {frame.start - heard_end:.6f} s after a reply")
        patient = (
            answered
            or self.misled_drives
            or self._lost_at >= last.start
            or since >= self._min_timeout_s - TIME_EPSILON_S
        )
        if not patient:
            self._violation(f"I6 spoke {since:.6f} s after a request that was neither answered nor given up")

    def _check_permission(self, frame: ClassifiedFrame) -> None:
        what, command = f"{frame.effect} to {frame.address}", frame.user_command
        if frame.address == self._broadcast and frame.effect is not RequestEffect.RELEASE:
            self._violation(f"I7 {what}: a broadcast")
        elif frame.effect is RequestEffect.RELEASE:
            if frame.address not in self._stop_commands:
                self._violation(f"I1 {what} without a wish")
        elif command is None:
            self._violation(f"I1 {what} without a wish")
        else:
            self._stop_commands.add(frame.address)
            if command.method == "jog":
                self._jogged.add(frame.address)
            self._check_command(frame, command, what)

    def _check_command(self, frame: ClassifiedFrame, wish: UserCommand, what: str) -> None:
        if frame.effect is RequestEffect.MOTION and frame.start - wish.at > PREPARATION_MAX_S + COMMAND_EXPIRY_S + 0.1:
            self._violation(f"I1 {what} {frame.start - wish.at:.3f} s after {wish}")
        if (
            self._stop_at.get(frame.address, -inf) > wish.at and wish.method != "write"
        ):  # 6.5 names start, setpoint, jog
            self._violation(f"I1 {what} for {wish}, after a newer stop")
        if self._lost_at > wish.at:
            self._violation(f"I10 {what} for {wish}, which is older than the port")
        if frame.effect is RequestEffect.MOTION and wish.method == "run":
            self._check_start(frame.address, wish)

    def _check_start(self, address: int, wish: UserCommand) -> None:
        """I2: never twice, unless a drive that can tell was looked at in between."""
        looks = self._status_reads[address] if self._reports_running else 0
        if self._started.get(address) is wish and looks < STATUS_READS_BETWEEN_STARTS:
            self._violation(f"I2 {wish} was sent again after {self._status_reads[address]} looks")
        self._started[address], self._status_reads[address] = wish, 0
