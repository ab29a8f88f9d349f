"""Rules of the invariants I1, I2, I3, I6, I7 and I10 for frames, writes and outcomes.

The reference codecs read the frames; no codec, profile or dialect of drivebus is used.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from datetime import date
from math import inf
from typing import Any

from verification.drive_variants import DriveVariant
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import decode_write
from verification.scenario.user_command import UserCommand

# --- frames -----------------------------------------------------------------------------------------------------------

TIME_EPSILON_S = 1e-9
PREPARATION_MAX_S = 5.0
"""Longest time from a user's command to the product's command object, in seconds: the checks before a start."""
COMMAND_EXPIRY_S = 2.0
"""Longest time from the command object to the first bit of a frame that moves the motor, in seconds."""
MIN_TIMEOUT_TOLERANCE_S = 0.1
STATUS_READS_BETWEEN_STARTS = 4
"""Requests before a start is sent again: two status reads, each after a sync probe."""


class ClassifiedFrame:
    """Frame of the master with its effect by the manual."""

    __slots__ = ("address", "effect", "end", "start", "user_command")

    def __init__(
        self, start: float, end: float, address: int, effect: RequestEffect, command: UserCommand | None = None
    ) -> None:
        self.start, self.end, self.address, self.effect, self.user_command = start, end, address, effect, command


class FrameRules:
    """Rules for the frames that a master may send, and when."""

    def __init__(self, variant: DriveVariant, character_s: float, violation: Callable[[str], None]) -> None:
        self._broadcast, self._reports_running = variant.broadcast, variant.reports_running
        self._violation = violation
        self._gap_s = max(variant.gap_characters * character_s, variant.gap_floor_s)
        self._min_timeout_s = min(
            variant.min_timeout_s + variant.min_timeout_characters * character_s, MIN_TIMEOUT_TOLERANCE_S
        )
        self.echo_may_look_damaged = False
        """Whether an echo may look like a damaged reply: its setting is wrong, it comes in batches, or the port has no
        line timing. The master may then give up as soon as it has received it."""
        self._last: ClassifiedFrame | None = None
        self._stop_due: float | None = None
        self._stop_at: dict[int, float] = {}
        self._lost_at = -inf
        self._stop_commands: set[int] = set()
        self._started: dict[int, UserCommand] = {}
        """Command of the last start sent, by address."""
        self._status_reads: Counter[int] = Counter()
        """Number of reads since the last start sent, by address."""
        self._jogged: set[int] = set()
        """Jogging addresses. The VC660 jogs by a level: the level bits at rest are the stop, until one of them was
        answered."""
        self._jogs: dict[int, UserCommand] = {}
        """Last jog that was sent, by address."""

    def on_stop_command(self, command: UserCommand, *, port_open: bool) -> None:
        """Require a stop as the next frame, unless the port is lost."""
        self._stop_commands.add(command.address)
        self._stop_at[command.address] = command.at
        if self._stop_due is None and port_open:
            self._stop_due = command.at

    def on_port_lost(self, now: float) -> None:
        """Invalidate every command from before the port was lost."""
        self._lost_at = now
        self._stop_due = None

    def on_request(self, frame: ClassifiedFrame, last_received_at: float, *, answered: bool) -> None:
        """Check a request. ``last_received_at``: end of the last received bit; ``answered``: a reply ended since the
        last request."""
        if self._last is not None:
            self._check_timing(frame, self._last, last_received_at, answered=answered)
            if answered and self._last.effect in (RequestEffect.STOP, RequestEffect.RELEASE):
                self._jogged.discard(self._last.address)
        self._last = frame
        if frame.effect is RequestEffect.STOP or (
            frame.effect is RequestEffect.RELEASE and frame.address in self._jogged
        ):
            self._stop_due = None
            # VC660: the levels without the pulse complete the stop, also a broadcast one
            self._stop_commands.add(frame.address)
            return
        if frame.effect is RequestEffect.RELEASE and self._is_end_of_jog(frame.address):
            return
        if self._stop_due is not None and frame.start > self._stop_due + TIME_EPSILON_S:
            self._violation(
                f"I3 {frame.effect} to {frame.address} was sent before a stop commanded at {self._stop_due:.6f}"
            )
        if frame.effect is not RequestEffect.READ:
            self._check_permission(frame)
        else:
            self._status_reads[frame.address] += 1

    def _is_end_of_jog(self, address: int) -> bool:
        """Return whether the level bits at rest end a jog whose drive has answered another stop meanwhile.

        That end was requested before: it may go before a commanded stop, which is still due after it.
        """
        jog = self._jogs.get(address)
        return jog is not None and not jog.is_ended

    def _check_timing(
        self, frame: ClassifiedFrame, last: ClassifiedFrame, last_received_at: float, *, answered: bool
    ) -> None:
        """Check that one request is outstanding at a time, and the gap before each (I6)."""
        since = frame.start - last.end
        if since < self._gap_s - TIME_EPSILON_S:
            self._violation(f"I6 {since:.6f} s after our own frame")
        if frame.start - last_received_at < self._gap_s - TIME_EPSILON_S and frame.effect is not RequestEffect.STOP:
            self._violation(f"I6 {frame.start - last_received_at:.6f} s after a reply")
        allowed = (
            answered
            or self.echo_may_look_damaged
            or self._lost_at >= last.start
            or since >= self._min_timeout_s - TIME_EPSILON_S
        )
        if not allowed:
            self._violation(f"I6 request {since:.6f} s after one that was neither answered nor timed out")

    def _check_permission(self, frame: ClassifiedFrame) -> None:
        what, command = f"{frame.effect} to {frame.address}", frame.user_command
        if frame.address == self._broadcast and frame.effect is not RequestEffect.RELEASE:
            self._violation(f"I7 {what}: a broadcast")
        elif frame.effect is RequestEffect.RELEASE:
            if frame.address not in self._stop_commands:
                self._violation(f"I1 {what} without a command")
        elif command is None:
            self._violation(f"I1 {what} without a command")
        else:
            self._stop_commands.add(frame.address)
            if command.method == "jog":
                self._jogged.add(frame.address)
                self._jogs[frame.address] = command
            self._check_command(frame, command, what)

    def _check_command(self, frame: ClassifiedFrame, command: UserCommand, what: str) -> None:
        if (
            frame.effect is RequestEffect.MOTION
            and frame.start - command.at > PREPARATION_MAX_S + COMMAND_EXPIRY_S + 0.1
        ):
            self._violation(f"I1 {what} {frame.start - command.at:.3f} s after {command}")
        # a parameter write stays valid after a stop
        if self._stop_at.get(frame.address, -inf) > command.at and command.method != "write":
            self._violation(f"I1 {what} for {command}, after a newer stop")
        if self._lost_at > command.at:
            self._violation(f"I10 {what} for {command}, which is older than the port")
        if frame.effect is RequestEffect.MOTION and command.method == "run":
            self._check_start(frame.address, command)

    def _check_start(self, address: int, command: UserCommand) -> None:
        """Check that a start is not sent twice without status reads in between (I2)."""
        status_reads = self._status_reads[address]
        enough = self._reports_running and status_reads >= STATUS_READS_BETWEEN_STARTS
        if self._started.get(address) is command and not enough:
            self._violation(f"I2 {command} was sent again after {status_reads} status reads")
        self._started[address], self._status_reads[address] = command, 0


# --- writes -----------------------------------------------------------------------------------------------------------

EEPROM_WRITES_PER_DAY = 20
"""Largest number of saves of one parameter a day."""


class WriteRules:
    """Rules for writes: listed addresses, range, EEPROM budget (I7)."""

    def __init__(self, variant: DriveVariant, violation: Callable[[str], None]) -> None:
        self._variant, self._violation = variant, violation
        self._saved: Counter[tuple[int, int, date]] = Counter()

    def on_write(self, frame: ClassifiedFrame, data: bytes, today: date) -> None:
        """Check a frame that is no read."""
        try:
            found = decode_write(self._variant, data)
        except ValueError as error:
            return self._violation(f"I7 {frame.effect} to {frame.address}: {error}")
        if found.hz is not None and found.hz > self._variant.maximum_hz:
            self._violation(f"I7 {frame.effect} to {frame.address} with {found.hz} Hz")
        if (
            found.saved
            and found.parameter is not None
            and frame.user_command is not None
            and frame.user_command.day == today
        ):
            place = frame.address, found.parameter, today
            self._saved[place] += 1
            if self._saved[place] > EEPROM_WRITES_PER_DAY:
                self._violation(f"I7 save {self._saved[place]} of parameter {found.parameter:X} of {frame.address}")
        return None


# --- history of one drive ---------------------------------------------------------------------------------------------

LOCAL_STOP_ACTIONS = frozenset({"keypad_stop", "power_cycle", "trip"})
LOCAL_ACTIONS = ("keypad_run", "keypad_set", *sorted(LOCAL_STOP_ACTIONS))
"""Actions at a station without a frame, and those of them that stop the motor."""
MAX_REMEMBERED_COMMANDS = 32


class DriveHistory:
    """History of one simulated drive: its frames, its motor's starts and its local actions, in bus time."""

    def __init__(self, station: Any, now: Callable[[], float], note: Callable[[str], None]) -> None:
        self.station, self._now, self._note = station, now, note
        self.stop_received_at = self.on_at = self.local_action_at = self.local_stop_at = -inf
        """Times of the last stop frame, motor start, local action and local stop."""
        self.reads = 0
        """Reads that the drive received since its last local stop."""
        self.started_for: UserCommand | None = None
        """Command that started the motor; None: the keypad."""
        self.commands: deque[UserCommand] = deque(maxlen=MAX_REMEMBERED_COMMANDS)
        """The last commands, ended or not."""
        for name in LOCAL_ACTIONS:
            setattr(station, name, self._record_local_action(name, getattr(station, name)))

    def _record_local_action(self, name: str, action: Callable[..., None]) -> Callable[..., None]:
        def on_action(*arguments: Any, **named: Any) -> None:
            was_on = self.station.motor.energised
            action(*arguments, **named)
            self.local_action_at = self._now()
            if name in LOCAL_STOP_ACTIONS:
                self.local_stop_at, self.reads = self.local_action_at, 0
            self._note(f"! {name} {self.station.address}")
            if self.station.motor.energised and not was_on:
                self.on_motor_started(None)

        return on_action

    def on_command(self, command: UserCommand) -> None:
        self.commands.append(command)

    def on_frame(self, frame: ClassifiedFrame) -> None:
        """Record a frame that the drive received."""
        self.reads += frame.effect is RequestEffect.READ
        if frame.effect is RequestEffect.STOP:
            self.stop_received_at = self._now()
        elif frame.user_command is not None:
            frame.user_command.frames_received += 1
            frame.user_command.motion_frames_received += frame.effect is RequestEffect.MOTION

    @property
    def stopped_unobserved(self) -> bool:
        """Whether a local action stopped the drive before the master saw it run, and two status reads after sync probes
        showed standstill."""
        return self.local_stop_at > self.on_at and self.reads >= STATUS_READS_BETWEEN_STARTS

    def on_motor_started(self, command: UserCommand | None) -> None:
        self.on_at, self.started_for = self._now(), command

    def is_undisturbed(self, command: UserCommand) -> bool:
        """Return whether no other command and no local action fell into the time of this command."""
        others = (other for other in self.commands if other is not command)
        overlap = any(other.ended_at is None or other.ended_at >= command.at for other in others)
        return not overlap and self.local_action_at < command.at

    @property
    def on(self) -> bool:
        return bool(self.station.motor.energised)


# --- outcomes ---------------------------------------------------------------------------------------------------------

UNSENT_ERRORS = frozenset(
    {"StartInhibited", "LimitError", "PreflightError", "CapabilityError", "Expired", "EepromBudgetExceeded"}
)
"""Errors that guarantee that no acting frame was sent."""
FREQUENCY_RESOLUTION_HZ = 0.11
"""Tolerance of frequencies, in Hz: the coarsest setpoint of the models is 0.1 Hz."""
ReportViolation = Callable[[str], None]


def check_outcome(
    command: UserCommand, history: DriveHistory, *, reports_running: bool, violation: ReportViolation
) -> None:
    """Check the result of a command that has just ended; ``reports_running``: the drive reports whether it runs."""

    def wrong(text: str) -> None:
        violation(f"{command}: {command.result_word}, but {text}")

    match command.result_word:
        case "confirmed":
            if not history.station.faults.frozen_readings:
                _check_confirmed(command, history, reports_running=reports_running, wrong=wrong)
        case "acknowledged":
            _check_acknowledged(command, history, reports_running=reports_running, wrong=wrong)
        case "refused" | "failed":
            _check_not_executed(command, history, wrong)
        case "unknown" | "PortLost" | "nothing":  # nothing: the scenario was closed meanwhile
            pass
        case word:  # an error without an outcome: nothing may have been executed
            if command.executions or (word in UNSENT_ERRORS and command.frames_sent):
                wrong(f"{command.frames_sent} frames were sent for it and {command.executions} switched the motor on")


def _check_confirmed(
    command: UserCommand, history: DriveHistory, *, reports_running: bool, wrong: ReportViolation
) -> None:
    if not reports_running and (command.is_stop or command.method in ("run", "jog", "reset_fault")):
        wrong("this drive can't tell")
    if command.is_stop:
        _check_stopped(command, history, wrong)
    elif command.method == "run":
        _check_running(command, history, wrong)
    elif (
        command.method == "reset_fault"
        and history.station.motor.trip is not None
        and history.local_action_at < command.at
    ):
        wrong("the drive has tripped")
    if command.method in ("run", "set_frequency") and history.on and history.is_undisturbed(command):
        _check_speed(command, history, wrong)


def _check_stopped(command: UserCommand, history: DriveHistory, wrong: ReportViolation) -> None:
    """Check that the motor is off, or was started again since, at the keypad or by a later command."""
    newer = history.started_for is None or history.started_for.at > command.at
    if history.on and not (history.on_at > max(command.at, history.stop_received_at) and newer):
        wrong("the motor is on")


def _check_running(command: UserCommand, history: DriveHistory, wrong: ReportViolation) -> None:
    """Check that the motor is on, or was stopped since by a stop frame or at the keypad."""
    if (
        not history.on
        and max(history.stop_received_at, history.local_stop_at) < command.at
        and history.station.motor.trip is None
    ):
        wrong("the motor is off")


def _check_speed(command: UserCommand, history: DriveHistory, wrong: ReportViolation) -> None:
    """Check that an undisturbed motor goes to the commanded frequency."""
    motor, wanted = history.station.motor, command.arguments[0]
    backward = command.method == "run" and "reverse" in command.arguments
    turned = history.started_for is command and (motor.target_hz < 0) is not backward
    if abs(abs(motor.target_hz) - wanted) > FREQUENCY_RESOLUTION_HZ or turned:
        wrong(f"it goes to {motor.target_hz} Hz")


def _check_acknowledged(
    command: UserCommand, history: DriveHistory, *, reports_running: bool, wrong: ReportViolation
) -> None:
    """Check that the drive received a frame of the command. A drive that reports running receives only its new
    frequency."""
    begins = command.method == "jog" or (command.method == "run" and not reports_running)
    if command.is_stop and history.stop_received_at < command.at:
        wrong("the drive received no stop")
    if not command.is_stop and not (command.motion_frames_received if begins else command.frames_received):
        wrong("the drive received no frame of it")
    if (
        command.method == "jog"
        and history.on
        and history.started_for is command
        and history.stop_received_at < history.on_at
    ):
        wrong("the jog ended and the drive received no stop")


def _check_not_executed(command: UserCommand, history: DriveHistory, wrong: ReportViolation) -> None:
    """Check that a refused command was not executed and that after a failed one the motor is off, unless the outcome
    reports otherwise."""
    if command.is_stop:
        wrong("stops have no such end")
    if command.result_word == "refused" and command.executions:
        wrong("the motor was switched on for it")
    reported = command.outcome is not None and command.outcome.key in (
        "drives.wrong_direction",
        "drives.setpoint_differs",
    )
    if (
        command.is_motion
        and history.on
        and history.started_for is command
        and history.stop_received_at < history.on_at
        and not reported
    ):
        wrong("the motor runs for it")
