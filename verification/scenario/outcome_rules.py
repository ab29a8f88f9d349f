"""What users were told of their commands, word by word, against the motor and what the drive heard."""

from __future__ import annotations

from collections.abc import Callable

from verification.scenario.drive_history import DriveHistory
from verification.scenario.user_command import UserCommand

UNSENT_ERRORS = frozenset(
    {"StartInhibited", "LimitError", "PreflightError", "CapabilityError", "Expired", "EepromBudgetExceeded"}
)
"""Errors that promise: nothing was sent that acts."""
FREQUENCY_RESOLUTION_HZ = 0.11
"""The coarsest setpoint of the families is 0.1 Hz."""
ReportViolation = Callable[[str], None]


def check_outcome(wish: UserCommand, deeds: DriveHistory, tells: bool, violation: ReportViolation) -> None:
    """The wish ended at this moment. ``tells``: the drive can say whether it runs."""

    def wrong(text: str) -> None:
        violation(f"{wish}: {wish.result_word}, but {text}")

    match wish.result_word:
        case "confirmed":
            if not deeds.station.faults.frozen_readings:
                _check_confirmed(wish, deeds, tells, wrong)
        case "acknowledged":
            _check_acknowledged(wish, deeds, tells, wrong)
        case "refused" | "failed":
            _check_not_executed(wish, deeds, wrong)
        case "unknown" | "PortLost" | "nothing":  # nothing: the stand was taken down meanwhile
            pass
        case word:  # an error without an outcome: what became of a start is never told so
            if wish.executions or (word in UNSENT_ERRORS and wish.frames_sent):
                wrong(f"{wish.frames_sent} frames left for it, and the motor was switched on {wish.executions} times")


def _check_confirmed(wish: UserCommand, deeds: DriveHistory, tells: bool, wrong: ReportViolation) -> None:
    if not tells and (wish.is_stop or wish.method in ("run", "jog", "reset_fault")):
        wrong("this drive can't tell")
    if wish.is_stop:
        _check_stopped(wish, deeds, wrong)
    elif wish.method == "run":
        _check_running(wish, deeds, wrong)
    elif wish.method == "reset_fault" and deeds.station.motor.trip is not None and deeds.local_action_at < wish.at:
        wrong("the drive has tripped")
    if wish.method in ("run", "set_frequency") and deeds.on and deeds.is_undisturbed(wish):
        _check_speed(wish, deeds, wrong)


def _check_stopped(wish: UserCommand, deeds: DriveHistory, wrong: ReportViolation) -> None:
    """Off, or switched on again since: by hand, or for somebody who wished for it later."""
    newer = deeds.started_for is None or deeds.started_for.at > wish.at
    if deeds.on and not (deeds.on_at > max(wish.at, deeds.stop_received_at) and newer):
        wrong("the motor is on")


def _check_running(wish: UserCommand, deeds: DriveHistory, wrong: ReportViolation) -> None:
    """On, or off again since: by a stop that was heard, or by hand."""
    if not deeds.on and max(deeds.stop_received_at, deeds.local_stop_at) < wish.at and deeds.station.motor.trip is None:
        wrong("the motor is off")


def _check_speed(wish: UserCommand, deeds: DriveHistory, wrong: ReportViolation) -> None:
    """Undisturbed it goes where it was told to go."""
    motor, wanted = deeds.station.motor, wish.arguments[0]
    backward = wish.method == "run" and "reverse" in wish.arguments
    turned = deeds.started_for is wish and (motor.target_hz < 0) is not backward
    if abs(abs(motor.target_hz) - wanted) > FREQUENCY_RESOLUTION_HZ or turned:
        wrong(f"it goes to {motor.target_hz} Hz")


def _check_acknowledged(wish: UserCommand, deeds: DriveHistory, tells: bool, wrong: ReportViolation) -> None:
    """The drive said yes, so it has heard it. One that tells that it runs already hears but its new frequency."""
    begins = wish.method == "jog" or (wish.method == "run" and not tells)
    if wish.is_stop and deeds.stop_received_at < wish.at:
        wrong("the drive heard no stop")
    if not wish.is_stop and not (wish.motion_frames_received if begins else wish.frames_received):
        wrong("the drive heard nothing of it")
    if wish.method == "jog" and deeds.on and deeds.started_for is wish and deeds.stop_received_at < deeds.on_at:
        wrong("it is over and no stop was heard")


def _check_not_executed(wish: UserCommand, deeds: DriveHistory, wrong: ReportViolation) -> None:
    """Refused: never done. Failed: the motor does not run for it, unless the other way round, which is said so."""
    if wish.is_stop:
        wrong("stops have no such end")
    if wish.result_word == "refused" and wish.executions:
        wrong("the motor was switched on for it")
    message = wish.outcome is not None and wish.outcome.key in ("drives.wrong_direction", "drives.setpoint_differs")
    if (
        wish.is_motion
        and deeds.on
        and deeds.started_for is wish
        and deeds.stop_received_at < deeds.on_at
        and not message
    ):
        wrong("the motor runs for it")
