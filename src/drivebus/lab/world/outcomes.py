"""What users were told of their commands, word by word, against the motor and what the drive heard (ruling 1)."""

from __future__ import annotations

from collections.abc import Callable

from drivebus.lab.world.deeds import Deeds
from drivebus.lab.world.wishes import Wish

UNSENT = frozenset({"GateError", "LimitError", "PreflightError", "CapabilityError", "Expired", "WearBudget"})
"""Errors that promise: nothing was sent that acts."""
STEP_HZ = 0.11
"""The coarsest setpoint of the families is 0.1 Hz."""
Tell = Callable[[str], None]


def check_outcome(wish: Wish, deeds: Deeds, tells: bool, violation: Tell) -> None:
    """The wish ended at this moment. ``tells``: the drive can say whether it runs."""

    def wrong(text: str) -> None:
        violation(f"{wish}: {wish.word}, but {text}")

    match wish.word:
        case "confirmed":
            if not deeds.station.faults.stuck:
                _confirmed(wish, deeds, tells, wrong)
        case "acknowledged":
            _acknowledged(wish, deeds, tells, wrong)
        case "refused" | "failed":
            _not_done(wish, deeds, wrong)
        case "unknown" | "PortLost" | "nothing":  # nothing: the stand was taken down meanwhile
            pass
        case word:  # an error without an outcome: what became of a start is never told so
            if wish.executions or (word in UNSENT and wish.sent):
                wrong(f"{wish.sent} frames left for it, and the motor was switched on {wish.executions} times")


def _confirmed(wish: Wish, deeds: Deeds, tells: bool, wrong: Tell) -> None:
    if not tells and (wish.stops or wish.what in ("run", "jog", "reset_fault")):
        wrong("this drive can't tell")
    if wish.stops:
        _stopped(wish, deeds, wrong)
    elif wish.what == "run":
        _running(wish, deeds, wrong)
    elif wish.what == "reset_fault" and deeds.station.motor.trip is not None and deeds.hand_at < wish.at:
        wrong("the drive has tripped")
    if wish.what in ("run", "set_frequency") and deeds.on and deeds.alone(wish):
        _at_speed(wish, deeds, wrong)


def _stopped(wish: Wish, deeds: Deeds, wrong: Tell) -> None:
    """Off, or switched on again since: by hand, or for somebody who wished for it later."""
    newer = deeds.on_for is None or deeds.on_for.at > wish.at
    if deeds.on and not (deeds.on_at > max(wish.at, deeds.stop_heard_at) and newer):
        wrong("the motor is on")


def _running(wish: Wish, deeds: Deeds, wrong: Tell) -> None:
    """On, or off again since: by a stop that was heard, or by hand."""
    if not deeds.on and max(deeds.stop_heard_at, deeds.hand_stop_at) < wish.at and deeds.station.motor.trip is None:
        wrong("the motor is off")


def _at_speed(wish: Wish, deeds: Deeds, wrong: Tell) -> None:
    """Undisturbed it goes where it was told to go."""
    motor, wanted = deeds.station.motor, wish.arguments[0]
    backward = wish.what == "run" and "reverse" in wish.arguments
    turned = deeds.on_for is wish and (motor.target_hz < 0) is not backward
    if abs(abs(motor.target_hz) - wanted) > STEP_HZ or turned:
        wrong(f"it goes to {motor.target_hz} Hz")


def _acknowledged(wish: Wish, deeds: Deeds, tells: bool, wrong: Tell) -> None:
    """The drive said yes, so it has heard it. One that tells that it runs already hears but its new frequency."""
    begins = wish.what == "jog" or (wish.what == "run" and not tells)
    if wish.stops and deeds.stop_heard_at < wish.at:
        wrong("the drive heard no stop")
    if not wish.stops and not (wish.moves_heard if begins else wish.heard):
        wrong("the drive heard nothing of it")
    if wish.what == "jog" and deeds.on and deeds.on_for is wish and deeds.stop_heard_at < deeds.on_at:
        wrong("it is over and no stop was heard")


def _not_done(wish: Wish, deeds: Deeds, wrong: Tell) -> None:
    """Refused: never done. Failed: the motor does not run for it, unless the other way round, which is said so."""
    if wish.stops:
        wrong("stops have no such end")
    if wish.word == "refused" and wish.executions:
        wrong("the motor was switched on for it")
    told = wish.outcome is not None and wish.outcome.key in ("drives.wrong_way", "drives.setpoint_differs")
    if wish.moves and deeds.on and deeds.on_for is wish and deeds.stop_heard_at < deeds.on_at and not told:
        wrong("the motor runs for it")
