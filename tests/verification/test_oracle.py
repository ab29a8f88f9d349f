"""The witness sees what is there to see: each invariant broken on purpose and found (I9: by ``failures``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus.core import BusCore
from drivebus.bus.messages import Permit
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.transaction import Transaction
from drivebus.drives.context import EepromBudget
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import get_bus_conditions
from drivebus.drives.permissives import PermitInputs
from drivebus.drives.state import DriveStatus
from drivebus.testing.virtual_time import running
from verification.campaign import CampaignRun
from verification.drive_variants import C320, C320_HEX, DF800, DRIVE_VARIANTS, DZB100, VC660, DriveVariant
from verification.fault_injection.wall_clock import JumpingWallClock, before_midnight, installed_clock
from verification.reference.request_effects import RequestEffect, classify_request
from verification.scenario.scenario import Scenario
from verification.scenario.write_rules import decode_write


@pytest.fixture
def session() -> CampaignRun:
    return CampaignRun("test", 1, 1)


def stand(session: CampaignRun, kind: DriveVariant = VC660, addresses: Any = (1, 2), **options: Any) -> Scenario:
    return Scenario(session, kind, addresses, **options)


def found(session: CampaignRun, invariant: str) -> bool:
    return any(f": {invariant} " in text for text in session.violations)


@pytest.mark.parametrize("kind", DRIVE_VARIANTS, ids=lambda kind: kind.name)
def test_an_honest_run_has_no_violation_and_a_story(session: CampaignRun, kind: DriveVariant) -> None:
    story: list[str] = []
    session.listener = story.append
    here = stand(session, kind, line_quality="lossy")
    here.monitor(1)
    run = here.command(1, "run", 12.0)
    here.finish(run)
    stop = here.command(1, "stop")
    here.finish(stop)
    here.close()
    assert session.violations == []
    assert here.oracle.accepted_count > 5
    assert any(" > 1 move " in line for line in story) or run.result_word not in ("confirmed", "acknowledged")
    assert stop.result_word in (("confirmed", "unknown") if kind.reports_running else ("acknowledged", "unknown"))


def test_a_remembered_wish_keeps_nothing_of_the_way_to_its_end(session: CampaignRun) -> None:
    """The frames of its error hold the whole conversation: a day of these was a quarter of the memory."""
    here = stand(session)
    here.station(1).faults.silent = True
    stop = here.command(1, "stop")
    assert stop.task is not None
    here.finish(stop)
    here.close()
    assert stop.result_word == "unknown" and stop.task is None
    assert stop.error is not None and stop.error.__traceback__ is stop.error.__cause__ is stop.error.__context__ is None


def test_i1_a_move_that_nobody_wished_for(session: CampaignRun) -> None:
    here = stand(session)
    here.loop.run_until_complete(here.drives[1].preflight())
    here.loop.run_until_complete(here.drives[1].run(12.0))
    assert found(session, "I1")


def test_i1_a_move_after_a_newer_stop(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest.permit_error", lambda job, now: None)
    monkeypatch.setattr(Scheduler, "supersede", lambda scheduler, stations: [])
    monkeypatch.setattr(OperationContext, "check_not_superseded", _always)
    monkeypatch.setattr("drivebus.drives.permissives.grant_permit", _granted)
    for instant in range(60):
        here = stand(session, C320)
        run = here.command(1, "run", 12.0)
        here.run(0.02 * instant)
        here.finish(here.command(1, "stop"), run)
        here.close()
    assert found(session, "I1")


def _always(talk: OperationContext, command: Any) -> Any:
    return (yield from get_bus_conditions()).now


def _granted(inputs: PermitInputs) -> Permit:
    return Permit(
        station=inputs.station,
        effect=inputs.effect,
        retry_policy=inputs.retry_policy,
        expires_at=inputs.conditions.now + 2.0,
        stop_epoch=inputs.conditions.stop_epoch,
    )


@pytest.mark.parametrize("kind", [DZB100, DF800], ids=lambda kind: kind.name)
def test_i2_a_start_that_is_sent_again_blindly(
    session: CampaignRun, monkeypatch: pytest.MonkeyPatch, kind: DriveVariant
) -> None:
    """Also where the second one finds the motor on and changes nothing."""
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest._max_write_attempts", lambda job: 3)
    here = stand(session, kind)
    here.loop.run_until_complete(here.drives[1].preflight())
    run = here.command(1, "run", 12.0)
    while 1 not in here.oracle.frame_rules._started:
        here.run(0.005)
    here.station(1).faults.mute = True
    here.run(0.3)
    here.station(1).faults.mute = False
    here.finish(run)
    assert found(session, "I2")


def test_i3_a_stop_that_waits_for_others(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Scheduler.next

    def late(scheduler: Scheduler, now: float) -> Any:
        """Polls before stops."""
        lanes = scheduler.queues
        scheduler.queues = (type(lanes[0])(), *lanes[1:])
        job = plain(scheduler, now)
        scheduler.queues = lanes
        return job or plain(scheduler, now)

    monkeypatch.setattr(Scheduler, "next", late)
    here = stand(session, VC660, range(1, 9))
    for address in here.drives:
        here.monitor(address)
    here.run(1.0)
    here.finish(here.command(1, "stop"))
    assert found(session, "I3")


@pytest.mark.parametrize(
    ("lie", "message"),
    [
        ("drivebus.drives.readings.ReadingPairs.with_staleness", lambda book, now, oldest: book.latest),
        ("drivebus.values.Reading.age_s", lambda reading, now: 0.0),
    ],
    ids=["good-for-ever", "calls-itself-new"],
)
def test_i4_a_silent_drive_whose_values_stay_good(
    session: CampaignRun, monkeypatch: pytest.MonkeyPatch, lie: str, message: Callable[..., object]
) -> None:
    """The witness takes nobody's word for an age."""
    monkeypatch.setattr(lie, message)
    here = stand(session)
    here.monitor(1)
    here.run(5.0)
    here.station(1).faults.silent = True
    here.run(120.0)
    assert found(session, "I4")


def test_i4_a_reading_whose_time_is_moved(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    here = stand(session)
    monitor = here.monitor(1)
    here.run(5.0)
    here.station(1).faults.silent = True
    status, now = monitor.status(), here.loop.time
    monkeypatch.setattr(monitor, "status", lambda: _refreshed(status, now()))
    here.run(120.0)
    assert found(session, "I4")


def _refreshed(status: DriveStatus, now: float) -> DriveStatus:
    return replace(status, readings={name: replace(one, source_time=now) for name, one in status.readings.items()})


def test_i5_a_late_reply_that_is_believed(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without quarantine and fence a late reply is the answer to the next request of its shape."""
    monkeypatch.setattr("drivebus.bus.core.BusCore._mark_suspect", lambda core, station, now: None)
    monkeypatch.setattr("drivebus.bus.station.Station.mark_suspect", lambda station, now: None)
    monkeypatch.setattr("drivebus.bus.core.BusCore._reject_reason", lambda core, transaction: None)
    here = stand(session, VC660, (1,), line_quality="late=0.2:0.3")
    here.monitor(1)
    here.run(300.0)
    assert found(session, "I5")


@pytest.mark.parametrize("kind", [C320, C320_HEX, VC660], ids=lambda kind: kind.name)
def test_i6_a_gap_that_is_too_short(session: CampaignRun, monkeypatch: pytest.MonkeyPatch, kind: DriveVariant) -> None:
    here = stand(session, kind, range(1, 9))
    for address, station in here.bus.core.stations.items():
        station.gap_s *= 0.9
        here.monitor(address)
    here.run(5.0)
    assert found(session, "I6")


def test_i6_a_second_request_while_one_is_out(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Transaction.__init__

    def hasty(transaction: Transaction, *given: Any, **named: Any) -> None:
        plain(transaction, *given, **named)
        transaction.deadline = transaction.ends_at = transaction.tx_end_at + 0.001

    monkeypatch.setattr(Transaction, "__init__", hasty)
    here = stand(session, DZB100, range(1, 9))
    for address in here.drives:
        here.monitor(address)
    here.run(5.0)
    assert found(session, "I6")


@pytest.mark.parametrize("kind", DRIVE_VARIANTS, ids=lambda kind: kind.name)
def test_i7_a_frequency_beyond_the_limit(
    session: CampaignRun, monkeypatch: pytest.MonkeyPatch, kind: DriveVariant
) -> None:
    monkeypatch.setattr("drivebus.drives.context.DriveContext._check_limits", lambda memory, hz: None)
    here = stand(session, kind)
    here.loop.run_until_complete(here.drives[1].preflight())
    here.finish(here.command(1, "run", kind.maximum_hz + 0.1))
    assert found(session, "I7")


@pytest.mark.parametrize("kind", DRIVE_VARIANTS, ids=lambda kind: kind.name)
def test_i7_one_save_more_than_a_day_has(
    session: CampaignRun, monkeypatch: pytest.MonkeyPatch, kind: DriveVariant
) -> None:
    """G16. A day is the wall clock's."""
    monkeypatch.setattr(EepromBudget, "consume", lambda wear, notation, day: iter(()))
    clock = JumpingWallClock(before_midnight(3600.0), lambda: 0.0)
    notation = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}[kind.model]
    with installed_clock(clock):
        here = stand(session, kind)
        for number in range(20):
            here.finish(here.command(1, "write", {notation: 10.0 + number}, True))
        assert session.violations == []
        here.finish(here.command(1, "write", {notation: 40.0}, True))
        assert found(session, "I7")
        session.violations.clear()
        clock.jump("+1 h")
        here.finish(here.command(1, "write", {notation: 10.0}, True))
        assert session.violations == []


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        (VC660, "01 06 20 0B 00 01"),
        (VC660, "01 06 81 C3 00 01"),
        (VC660, "01 06 20 00 00 81"),
        (DF800, "01 06 20 00 00 0E"),
        (DF800, "01 06 20 00 00 21"),
        (DF800, "01 06 20 02 00 01"),
        (DF800, "01 06 00 05 00 01"),
        (DZB100, "50 03 01 30 31 38 31 30 30 30 30"),
    ],
    ids=lambda given: getattr(given, "name", given),
)
def test_i7_what_is_on_no_list(kind: DriveVariant, frame: str) -> None:
    """T12, T16: 200BH, a place behind the last, codes without a meaning, the toggle, a monitor."""
    check = b"" if kind is DZB100 else b"\0\0"
    with pytest.raises(ValueError):
        decode_write(kind, bytes.fromhex(frame) + check)


def test_i8_an_error_that_escapes(session: CampaignRun) -> None:
    here = stand(session)

    def fails(status: Any) -> None:
        raise ZeroDivisionError("a sink that fails")

    with running(here.loop):
        here.drives[1].monitor(on_change=fails)
    here.run(1.0)
    assert found(session, "I8")


def test_i10_a_start_from_before_the_port_was_lost(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest.permit_error", lambda job, now: None)
    monkeypatch.setattr(BusCore, "on_port_lost", _forgets_nothing)
    monkeypatch.setattr("drivebus.bus.scheduler.Scheduler._reject_if_stale", lambda scheduler, lane, job, now: False)
    here = stand(session, C320)
    for instant in range(40):
        run = here.command(1, "run", 12.0)
        here.run(0.02 * instant)
        here.unplug()
        here.replug()
        here.finish(run)
        here.station(1).keypad_stop()
        here.run(20.0)
    assert found(session, "I10")


def _forgets_nothing(core: BusCore, error: Exception, now: float) -> list[Any]:
    """The port is gone, and what was queued stays queued."""
    core.is_open = False
    flight, core.transaction = core.transaction, None
    if flight is not None:
        core.scheduler.enqueue(flight.prepared)
    commands, core._commands = core._commands, []
    return commands


def test_i11_a_read_that_acts(session: CampaignRun) -> None:
    here = stand(session)
    station = here.station(1)
    answer = station.handle_request

    def acts(message: Any, codec: Any) -> Any:
        station.setpoint_hz += 1.0
        return answer(message, codec)

    station.handle_request = acts
    here.monitor(1)
    here.run(1.0)
    assert found(session, "I11")


def test_i12_questions_that_are_remembered_for_ever(session: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    monkeypatch.setattr(
        BusCore, "_remember_unanswered", lambda core, transaction, now: kept.append((now, transaction.prepared))
    )
    here = stand(session, line_quality="loss=0.1")
    here.bus.core.stations[1].unanswered_requests = kept
    here.monitor(1)
    here.run(1500.0)
    here.close()
    assert found(session, "I12")


def test_i12_a_queue_that_nobody_empties(session: CampaignRun) -> None:
    here = stand(session)
    with running(here.loop):
        for _ in range(500):
            here.loop.create_task(here.drives[1].read(("F00.00",)))
    here.run(0.1)
    assert found(session, "I12")


def test_the_manuals_tables_know_every_request() -> None:
    """T01, T07, T16: what the observer's own tables say of frames from the manuals."""
    message = {
        ("c320", "ascii", "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D"): (0, RequestEffect.READ),
        ("c320", "ascii", "2A 30 30 34 31 31 30 33 45 37 30 31 44 35 0D"): (0, RequestEffect.MOTION),
        ("c320", "ascii", "2A 30 30 32 30 31 30 30 31 30 31 38 34 0D"): (0, RequestEffect.MOTION),
        ("c320", "ascii", "2A 31 46 34 32 31 30 30 30 30 30 31 43 45 0D"): (31, RequestEffect.STOP),
        ("c320", "hex", "5A 00 00 03 00 00 00 00 02 00 00 17 72 00 00 00 8E 0D"): (0, RequestEffect.SETTING),
        ("vc660", "rtu", "01 06 20 00 00 01 43 CA"): (1, RequestEffect.MOTION),
        ("vc660", "rtu", "01 06 20 00 00 02 03 CB"): (1, RequestEffect.STOP),
        ("vc660", "rtu", "01 06 20 00 00 84 00 00"): (1, RequestEffect.RELEASE),
        ("df800", "rtu", "01 06 20 00 00 01 43 CA"): (1, RequestEffect.STOP),
        ("df800", "rtu", "01 06 20 00 00 0A 00 00"): (1, RequestEffect.MOTION),
        ("dzb100", "ascii", "43 03 01 30 31 30 31 30 30 36 34"): (1, RequestEffect.MOTION),
        ("dzb100", "ascii", "43 03 01 30 31 30 30 30 30 30 30"): (1, RequestEffect.STOP),
    }
    for (family, encoding, frame), meaning in message.items():
        assert classify_request(family, encoding, bytes.fromhex(frame)) == meaning, frame


@pytest.mark.parametrize(
    "frame", ["2A 30 30 37 30 30 30 30 30 30 31 38 31 0D", "2A 30 30 31 32 32 30 30 30 30 31 38 31 0D"]
)
def test_the_manuals_tables_refuse_what_no_manual_knows(frame: str) -> None:
    with pytest.raises(ValueError):
        classify_request("c320", "ascii", bytes.fromhex(frame))


def test_i8_what_escapes_from_a_command_is_found(session: CampaignRun) -> None:
    async def fails() -> None:
        raise RuntimeError("not ours")

    here = stand(session)
    here.finish(here.command_by(fails, 1, "run"))
    assert found(session, "I8")


def test_a_lease_that_is_renewed_lives_on_the_loop_of_the_laboratory(session: CampaignRun) -> None:
    async def jog() -> Any:
        async with here.drives[1].jog() as lease:
            for _ in range(3):
                await asyncio.sleep(0.3)
                lease.renew()
        return lease.start_outcome

    here = stand(session)
    command = here.command_by(jog, 1, "jog")
    here.finish(command)
    assert command.result_word == "acknowledged" and session.violations == []
