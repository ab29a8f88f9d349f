"""Start permissives: each reason to withhold a permit, one by one (I1, I7)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus import i18n
from drivebus.bus.messages import Permit, RetryPolicy
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.permissives import (
    COMMAND_TTL_S,
    MAX_STATUS_AGE_S,
    MIN_DAMAGED_REPLIES,
    CommandKind,
    DriveCommand,
    DriveEvidence,
    PermitInputs,
    grant_permit,
)
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import DrivebusError, Expired, NotPermitted, StartInhibited, Superseded
from drivebus.protocols.codec import Effect

START = DriveCommand("start-1", CommandKind.START, 10.0, 3)
CONDITIONS = BusConditions(now=10.5, day="2026-01-02", stop_epoch=3)
STANDSTILL = DriveEvidence(
    derived=DerivedState(DriveState.STOPPED),
    state_at=10.4,
    reports_run_state=True,
    preflight_passed=True,
    limits_checked=True,
    is_prepared=True,
    motion_seen=False,
    run_seen=False,
)


def request_permit(
    command: DriveCommand = START,
    effect: Effect = Effect.MOTION,
    conditions: BusConditions = CONDITIONS,
    evidence: DriveEvidence = STANDSTILL,
    family: str = "sunfar",
) -> Permit:
    return grant_permit(
        PermitInputs(
            command=command,
            station=7,
            effect=effect,
            retry_policy=RetryPolicy.EDGE_TRIGGERED,
            conditions=conditions,
            evidence=evidence,
            family=family,
        )
    )


def check_withheld(kind: type[DrivebusError], key: str, **changes: object) -> None:
    with pytest.raises(kind) as caught:
        request_permit(**changes)  # type: ignore[arg-type]
    assert caught.value.key == key


def test_a_start_with_all_permissives_gets_a_permit_for_its_station_and_stop_epoch_only() -> None:
    permit = request_permit()
    assert (permit.station, permit.effect, permit.stop_epoch) == (7, Effect.MOTION, 3)
    assert permit.expires_at == 12.0
    assert permit.command_id == "start-1"


def test_a_start_expires_two_seconds_after_its_request() -> None:
    request_permit(conditions=replace(CONDITIONS, now=12.0), evidence=replace(STANDSTILL, state_at=11.9))
    check_withheld(
        Expired,
        "drives.expired",
        conditions=replace(CONDITIONS, now=12.001),
        evidence=replace(STANDSTILL, state_at=12.0),
    )


def test_a_setpoint_lives_five_seconds_but_not_where_its_frame_moves() -> None:
    setpoint = DriveCommand("setpoint-1", CommandKind.SETPOINT, 10.0, 3)
    assert request_permit(setpoint, Effect.SETTING).expires_at == 15.0
    runs = replace(STANDSTILL, derived=DerivedState(DriveState.RUNNING))
    assert request_permit(setpoint, Effect.MOTION, evidence=runs).expires_at == 12.0


def test_a_newer_stop_supersedes_the_command() -> None:
    check_withheld(Superseded, "drives.superseded", conditions=replace(CONDITIONS, stop_epoch=4))


def test_a_start_inhibited_drive_gets_no_permit() -> None:
    check_withheld(StartInhibited, "drives.start_inhibited", conditions=replace(CONDITIONS, start_inhibited=True))
    check_withheld(
        StartInhibited,
        "drives.start_inhibited",
        effect=Effect.SETTING,
        conditions=replace(CONDITIONS, start_inhibited=True),
    )


def test_a_foreign_master_blocks_everything_that_acts() -> None:
    check_withheld(StartInhibited, "drives.foreign_master", conditions=replace(CONDITIONS, foreign_master=True))


def test_two_drives_at_one_address_are_not_commanded() -> None:
    check_withheld(StartInhibited, "drives.duplicate", conditions=replace(CONDITIONS, duplicate_address=True))
    assert "through a repeater" in i18n.text("drives.duplicate", "en", station=1)
    assert "中继器" in i18n.text("drives.duplicate", "zh", station=1)


@pytest.mark.parametrize(("family", "limit"), [("sunfar", 0.01), ("modbus", 0.01), ("dzb100", 0.001)])
def test_a_high_error_rate_inhibits_a_start(family: str, limit: float) -> None:
    request_permit(conditions=replace(CONDITIONS, damage_rate=limit, damaged=9), family=family)
    bad = replace(CONDITIONS, damage_rate=limit * 1.01, damaged=9)
    check_withheld(StartInhibited, "drives.high_error_rate", conditions=bad, family=family)


def test_one_lost_frame_is_no_error_rate() -> None:
    request_permit(conditions=replace(CONDITIONS, damage_rate=0.5, damaged=2))
    check_withheld(StartInhibited, "drives.high_error_rate", conditions=replace(CONDITIONS, damage_rate=0.5, damaged=3))


def test_a_start_needs_a_fresh_status() -> None:
    check_withheld(StartInhibited, "drives.status_stale", evidence=replace(STANDSTILL, state_at=None))
    old = replace(STANDSTILL, state_at=CONDITIONS.now - MAX_STATUS_AGE_S - 0.01)
    check_withheld(StartInhibited, "drives.status_stale", evidence=old)


def test_a_family_without_a_run_status_is_judged_by_its_preflight_alone() -> None:
    blind = replace(STANDSTILL, derived=DerivedState(DriveState.UNKNOWN), state_at=None, reports_run_state=False)
    request_permit(evidence=blind)
    check_withheld(StartInhibited, "drives.preflight_not_done", evidence=replace(blind, preflight_passed=False))


@pytest.mark.parametrize("state", [state for state in DriveState if state is not DriveState.STOPPED])
def test_a_start_begins_at_standstill_and_nowhere_else(state: DriveState) -> None:
    key = "drives.state_not_known" if state is DriveState.UNKNOWN else "drives.state_forbids"
    check_withheld(StartInhibited, key, evidence=replace(STANDSTILL, derived=DerivedState(state)))


@pytest.mark.parametrize("state", [state for state in DriveState if state is not DriveState.PAUSED])
def test_a_run_is_resumed_from_a_pause_and_from_no_other_state(state: DriveState) -> None:
    """At standstill the same word would start a motor that was stopped since the pause."""
    resume = DriveCommand("x", CommandKind.RESUME, 10.0, 3)
    paused = replace(STANDSTILL, derived=DerivedState(DriveState.PAUSED), motion_seen=True)
    assert request_permit(resume, evidence=paused).effect is Effect.MOTION, "it turned when the command began"
    key = "drives.state_not_known" if state is DriveState.UNKNOWN else "drives.state_forbids"
    check_withheld(StartInhibited, key, command=resume, evidence=replace(STANDSTILL, derived=DerivedState(state)))


@pytest.mark.parametrize("kind", [CommandKind.WRITE, CommandKind.RESET, CommandKind.PAUSE])
def test_a_write_reset_or_pause_can_not_be_granted_motion(kind: CommandKind) -> None:
    check_withheld(NotPermitted, "drives.frame_would_move", command=DriveCommand("x", kind, 10.0, 3))


def test_a_write_to_input_terminals_is_granted_motion_in_any_state_but_not_on_a_bad_or_inhibited_bus() -> None:
    inputs = DriveCommand("x", CommandKind.INPUTS, 10.0, 3)
    running = replace(STANDSTILL, derived=DerivedState(DriveState.RUNNING), limits_checked=False)
    assert request_permit(inputs, Effect.MOTION, evidence=running).expires_at == 12.0
    for key, changed in (
        ("drives.high_error_rate", replace(CONDITIONS, damage_rate=1.0, damaged=9)),
        ("drives.start_inhibited", replace(CONDITIONS, start_inhibited=True)),
    ):
        check_withheld(StartInhibited, key, command=inputs, effect=Effect.MOTION, conditions=changed)


@pytest.mark.parametrize("effect", [Effect.NONE, Effect.STOP])
def test_reads_and_stops_need_no_permit_and_get_none(effect: Effect) -> None:
    check_withheld(NotPermitted, "drives.no_permit_needed", effect=effect)


def test_unchecked_limits_stop_a_start() -> None:
    check_withheld(StartInhibited, "drives.limits_unchecked", evidence=replace(STANDSTILL, limits_checked=False))


@pytest.mark.parametrize("kind", ["start", "jog"])
def test_a_motor_that_turned_when_the_command_began_is_not_started(kind: str) -> None:
    stopped = replace(STANDSTILL, motion_seen=True)
    command = DriveCommand("x", CommandKind(kind), 10.0, 3)
    check_withheld(StartInhibited, "drives.stopped_meanwhile", command=command, evidence=stopped)


def test_a_motor_that_ran_when_the_command_began_is_not_run_again_after_a_pause() -> None:
    paused = replace(STANDSTILL, derived=DerivedState(DriveState.PAUSED), motion_seen=True)
    resume = DriveCommand("x", CommandKind.RESUME, 10.0, 3)
    request_permit(resume, evidence=paused)
    check_withheld(StartInhibited, "drives.paused_meanwhile", command=resume, evidence=replace(paused, run_seen=True))


def test_a_drive_that_needs_a_word_before_a_start_gets_that_word_and_no_start() -> None:
    """DRIVECOM: 6 and 7 are settings; F, which starts, waits for the status that the profile calls ready."""
    unprepared = replace(STANDSTILL, is_prepared=False)
    check_withheld(StartInhibited, "drives.not_prepared", evidence=unprepared)
    assert request_permit(effect=Effect.SETTING, evidence=unprepared).effect is Effect.SETTING


EXPIRIES_S = {
    "start": 2.0,
    "jog": 2.0,
    "setpoint": 5.0,
    "pause": 5.0,
    "resume": 2.0,
    "ramp_hold": 2.0,
    "reset": 2.0,
    "write": 5.0,
    "inputs": 2.0,
}


def test_every_kind_of_command_expires() -> None:
    assert list(EXPIRIES_S) == [kind.value for kind in CommandKind]


@pytest.mark.parametrize(("kind", "seconds"), EXPIRIES_S.items())
def test_every_command_expires_after_the_limit_of_its_kind(kind: str, seconds: float) -> None:
    command = DriveCommand("x", CommandKind(kind), 10.0, 3)
    last = replace(CONDITIONS, now=10.0 + seconds)
    state = DriveState.PAUSED if command.kind is CommandKind.RESUME else DriveState.STOPPED
    fresh = replace(STANDSTILL, derived=DerivedState(state), state_at=last.now)
    assert COMMAND_TTL_S[command.kind] == seconds
    assert request_permit(command, Effect.SETTING, last, fresh).expires_at == last.now
    check_withheld(
        Expired,
        "drives.expired",
        command=command,
        effect=Effect.SETTING,
        conditions=replace(last, now=last.now + 0.001),
    )


def test_an_expired_command_says_its_age_and_its_limit_in_hundredths_of_a_second() -> None:
    with pytest.raises(Expired) as caught:
        request_permit(conditions=replace(CONDITIONS, now=13.23456))
    assert caught.value.params == {"age_s": 3.23, "limit_s": 2.0}
    with pytest.raises(Expired) as caught:
        request_permit(replace(START, created_at=10.00123), conditions=replace(CONDITIONS, now=13.0))
    assert caught.value.params["limit_s"] == 2.0


def test_a_status_is_fresh_for_two_seconds_and_not_longer() -> None:
    young = replace(START, created_at=99.0)
    conditions = replace(CONDITIONS, now=100.0)
    request_permit(young, conditions=conditions, evidence=replace(STANDSTILL, state_at=98.0))
    with pytest.raises(StartInhibited) as caught:
        request_permit(young, conditions=conditions, evidence=replace(STANDSTILL, state_at=97.98765))
    assert caught.value.params == {"age_s": 2.01, "limit_s": 2.0}


def test_three_failures_are_an_error_rate() -> None:
    assert MIN_DAMAGED_REPLIES == 3
    with pytest.raises(StartInhibited) as caught:
        request_permit(conditions=replace(CONDITIONS, damage_rate=0.123456, damaged=3), family="modbus")
    assert caught.value.key == "drives.high_error_rate"
    assert caught.value.params == {"error_percent": 12.35, "limit_percent": 1.0}


@pytest.mark.parametrize(
    ("kind", "state"),
    [
        (CommandKind.START, DriveState.STOPPED),
        (CommandKind.JOG, DriveState.STOPPED),
        (CommandKind.RESUME, DriveState.PAUSED),
    ],
)
@pytest.mark.parametrize("effect", [Effect.SETTING, Effect.MOTION])
def test_a_start_jog_or_resume_needs_link_drive_and_limits_whatever_its_frame_does(
    kind: CommandKind, state: DriveState, effect: Effect
) -> None:
    """The kind of the command counts, not only the effect of these bytes."""
    command = DriveCommand("x", kind, 10.0, 3)
    ready = replace(STANDSTILL, derived=DerivedState(state))
    request_permit(command, effect, evidence=ready)
    check_withheld(
        StartInhibited,
        "drives.high_error_rate",
        command=command,
        effect=effect,
        conditions=replace(CONDITIONS, damage_rate=1.0, damaged=9),
    )
    check_withheld(
        StartInhibited,
        "drives.preflight_not_done",
        command=command,
        effect=effect,
        evidence=replace(ready, preflight_passed=False),
    )
    check_withheld(
        StartInhibited,
        "drives.limits_unchecked",
        command=command,
        effect=effect,
        evidence=replace(ready, limits_checked=False),
    )
    turns = replace(STANDSTILL, derived=DerivedState(DriveState.RUNNING))
    check_withheld(StartInhibited, "drives.state_forbids", command=command, effect=effect, evidence=turns)


RUNNING = [DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING]


@pytest.mark.parametrize("kind", [CommandKind.SETPOINT, CommandKind.RAMP_HOLD])
@pytest.mark.parametrize("state", DriveState)
def test_a_setpoint_or_ramp_hold_whose_frame_moves_only_changes_a_run(kind: CommandKind, state: DriveState) -> None:
    """DZB100's setpoint is a run frame: at standstill it would start the motor."""
    command = DriveCommand("x", kind, 10.0, 3)
    evidence = replace(STANDSTILL, derived=DerivedState(state), motion_seen=True)
    if state in RUNNING:
        request_permit(command, evidence=evidence)
    else:
        key = "drives.state_not_known" if state is DriveState.UNKNOWN else "drives.state_forbids"
        check_withheld(StartInhibited, key, command=command, evidence=evidence)
    check_withheld(
        StartInhibited,
        "drives.high_error_rate",
        command=command,
        conditions=replace(CONDITIONS, damage_rate=1.0, damaged=9),
    )


def test_a_setpoint_that_only_sets_needs_its_limits_and_nothing_of_the_drive() -> None:
    setpoint = DriveCommand("x", CommandKind.SETPOINT, 10.0, 3)
    nothing = replace(STANDSTILL, derived=DerivedState(DriveState.UNKNOWN), state_at=None, preflight_passed=False)
    request_permit(setpoint, Effect.SETTING, replace(CONDITIONS, damage_rate=1.0, damaged=9), nothing)
    check_withheld(
        StartInhibited,
        "drives.limits_unchecked",
        command=setpoint,
        effect=Effect.SETTING,
        evidence=replace(nothing, limits_checked=False),
    )


@pytest.mark.parametrize("kind", [CommandKind.WRITE, CommandKind.RESET])
def test_a_write_or_a_reset_asks_for_no_limits_and_no_state(kind: CommandKind) -> None:
    """A drive in a fault on a bad link must be resettable."""
    faulty = replace(
        STANDSTILL,
        derived=DerivedState(DriveState.FAULT),
        state_at=None,
        preflight_passed=False,
        limits_checked=False,
    )
    command = DriveCommand("x", kind, 10.0, 3)
    permit = request_permit(command, Effect.SETTING, replace(CONDITIONS, damage_rate=1.0, damaged=9), faulty)
    assert (permit.effect, permit.retry_policy, permit.stop_epoch) == (Effect.SETTING, RetryPolicy.EDGE_TRIGGERED, 3)
