"""The witness sees what is there to see: each invariant broken on purpose and found (I9: by ``failures``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus.core import BusCore
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.transaction import Transaction
from drivebus.drives.operation import Talk
from drivebus.drives.state import DriveStatus
from drivebus.drives.talk import look
from drivebus.drives.wear import Wear
from drivebus.lab.breaking.wallclock import WallClock, before_midnight, installed
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import C320, C320_HEX, DF800, DZB100, KINDS, VC660, Kind
from drivebus.lab.manual import Does, request
from drivebus.lab.world.loop import running
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.writes import written
from drivebus.message import Permit


@pytest.fixture
def session() -> Session:
    return Session("test", 1, 1)


def stand(session: Session, kind: Kind = VC660, addresses: Any = (1, 2), **options: Any) -> Stand:
    return Stand(session, kind, addresses, **options)


def found(session: Session, invariant: str) -> bool:
    return any(f": {invariant} " in text for text in session.violations)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_an_honest_run_has_no_violation_and_a_story(session: Session, kind: Kind) -> None:
    story: list[str] = []
    session.listener = story.append
    here = stand(session, kind, weather="lossy")
    here.monitor(1)
    run = here.wish(1, "run", 12.0)
    here.finish(run)
    stop = here.wish(1, "stop")
    here.finish(stop)
    here.close()
    assert session.violations == []
    assert here.witness.accepted > 5
    assert any(" > 1 move " in line for line in story) or run.word not in ("confirmed", "acknowledged")
    assert stop.word in (("confirmed", "unknown") if kind.tells else ("acknowledged", "unknown"))


def test_g13_a_remembered_wish_keeps_nothing_of_the_way_to_its_end(session: Session) -> None:
    """The frames of its error hold the whole conversation: a day of these was a quarter of the memory."""
    here = stand(session)
    here.station(1).faults.silent = True
    stop = here.wish(1, "stop")
    assert stop.task is not None
    here.finish(stop)
    here.close()
    assert stop.word == "unknown" and stop.task is None
    assert stop.error is not None and stop.error.__traceback__ is stop.error.__cause__ is stop.error.__context__ is None


def test_i1_a_move_that_nobody_wished_for(session: Session) -> None:
    here = stand(session)
    here.loop.run(here.drives[1].preflight())
    here.loop.run(here.drives[1].run(12.0))
    assert found(session, "I1")


def test_i1_a_move_after_a_newer_stop(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.job.Job.refusal", lambda job, now: None)
    monkeypatch.setattr(Scheduler, "supersede", lambda scheduler, stations: [])
    monkeypatch.setattr(Talk, "still_wanted", _always)
    monkeypatch.setattr("drivebus.drives.gate.grant", _granted)
    for instant in range(60):
        here = stand(session, C320)
        run = here.wish(1, "run", 12.0)
        here.run(0.02 * instant)
        here.finish(here.wish(1, "stop"), run)
        here.close()
    assert found(session, "I1")


def _always(talk: Talk, command: Any) -> Any:
    return (yield from look()).now


def _granted(command: Any, address: int, effect: Any, write_class: Any, around: Any, *rest: Any) -> Permit:
    return Permit(address, effect, write_class, around.now + 2.0, around.generation)


@pytest.mark.parametrize("kind", [DZB100, DF800], ids=lambda kind: kind.name)
def test_i2_a_start_that_is_sent_again_blindly(session: Session, monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    """Also where the second one finds the motor on and changes nothing."""
    monkeypatch.setattr("drivebus.bus.job.Job._attempts_allowed", lambda job: 3)
    here = stand(session, kind)
    here.loop.run(here.drives[1].preflight())
    run = here.wish(1, "run", 12.0)
    while 1 not in here.witness.conduct._started:
        here.run(0.005)
    here.station(1).faults.mute = True
    here.run(0.3)
    here.station(1).faults.mute = False
    here.finish(run)
    assert found(session, "I2")


def test_i3_a_stop_that_waits_for_others(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Scheduler.next

    def late(scheduler: Scheduler, now: float) -> Any:
        """Polls before stops."""
        lanes = scheduler.lanes
        scheduler.lanes = (type(lanes[0])(), *lanes[1:])
        job = plain(scheduler, now)
        scheduler.lanes = lanes
        return job or plain(scheduler, now)

    monkeypatch.setattr(Scheduler, "next", late)
    here = stand(session, VC660, range(1, 9))
    for address in here.drives:
        here.monitor(address)
    here.run(1.0)
    here.finish(here.wish(1, "stop"))
    assert found(session, "I3")


@pytest.mark.parametrize(
    ("lie", "told"),
    [
        ("drivebus.drives.book.Book.aged", lambda book, now, oldest: book.latest),
        ("drivebus.reading.Reading.age_s", lambda reading, now: 0.0),
    ],
    ids=["good-for-ever", "calls-itself-new"],
)
def test_i4_a_silent_drive_whose_values_stay_good(
    session: Session, monkeypatch: pytest.MonkeyPatch, lie: str, told: Callable[..., object]
) -> None:
    """The witness takes nobody's word for an age."""
    monkeypatch.setattr(lie, told)
    here = stand(session)
    here.monitor(1)
    here.run(5.0)
    here.station(1).faults.silent = True
    here.run(120.0)
    assert found(session, "I4")


def test_i4_a_reading_whose_time_is_moved(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_i5_a_late_reply_that_is_believed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without quarantine and fence a late reply is the answer to the next request of its shape."""
    monkeypatch.setattr("drivebus.bus.stations.Station.doubt", lambda station, now, *more: None)
    monkeypatch.setattr("drivebus.bus.aftermath.disbelief", lambda core, flight: None)
    here = stand(session, VC660, (1,), weather="late=0.2:0.3")
    here.monitor(1)
    here.run(300.0)
    assert found(session, "I5")


@pytest.mark.parametrize("kind", [C320, C320_HEX, VC660], ids=lambda kind: kind.name)
def test_i6_a_gap_that_is_too_short(session: Session, monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    here = stand(session, kind, range(1, 9))
    for address, station in here.bus.core.stations.items():
        station.gap_s *= 0.9
        here.monitor(address)
    here.run(5.0)
    assert found(session, "I6")


def test_i6_a_second_request_while_one_is_out(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Transaction.__init__

    def hasty(transaction: Transaction, *given: Any, **named: Any) -> None:
        plain(transaction, *given, **named)
        transaction.deadline = transaction.final_at = transaction.sent_end + 0.001

    monkeypatch.setattr(Transaction, "__init__", hasty)
    here = stand(session, DZB100, range(1, 9))
    for address in here.drives:
        here.monitor(address)
    here.run(5.0)
    assert found(session, "I6")


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_i7_a_frequency_beyond_the_limit(session: Session, monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    monkeypatch.setattr("drivebus.drives.memory.Memory._check_limits", lambda memory, hz: None)
    here = stand(session, kind)
    here.loop.run(here.drives[1].preflight())
    here.finish(here.wish(1, "run", kind.maximum_hz + 0.1))
    assert found(session, "I7")


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_i7_one_save_more_than_a_day_has(session: Session, monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    """G16. A day is the wall clock's."""
    monkeypatch.setattr(Wear, "charge", lambda wear, notation, day: iter(()))
    clock = WallClock(before_midnight(3600.0), lambda: 0.0)
    notation = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}[kind.model]
    with installed(clock):
        here = stand(session, kind)
        for number in range(20):
            here.finish(here.wish(1, "write", {notation: 10.0 + number}, True))
        assert session.violations == []
        here.finish(here.wish(1, "write", {notation: 40.0}, True))
        assert found(session, "I7")
        session.violations.clear()
        clock.jump("+1 h")
        here.finish(here.wish(1, "write", {notation: 10.0}, True))
        assert session.violations == []


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        (VC660, "01 06 20 0B 00 01"), (VC660, "01 06 81 C3 00 01"), (VC660, "01 06 20 00 00 81"),
        (DF800, "01 06 20 00 00 0E"), (DF800, "01 06 20 00 00 21"), (DF800, "01 06 20 02 00 01"),
        (DF800, "01 06 00 05 00 01"), (DZB100, "50 03 01 30 31 38 31 30 30 30 30"),
    ],
    ids=lambda given: getattr(given, "name", given),
)  # fmt: skip
def test_i7_what_is_on_no_list(kind: Kind, frame: str) -> None:
    """T12, T16: 200BH, a place behind the last, codes without a meaning, the toggle, a monitor."""
    check = b"" if kind is DZB100 else b"\0\0"
    with pytest.raises(ValueError):
        written(kind, bytes.fromhex(frame) + check)


def test_i8_an_error_that_escapes(session: Session) -> None:
    here = stand(session)

    def fails(status: Any) -> None:
        raise ZeroDivisionError("a sink that fails")

    with running(here.loop):
        here.drives[1].monitor(on_change=fails)
    here.run(1.0)
    assert found(session, "I8")


def test_i10_a_start_from_before_the_port_was_lost(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.job.Job.refusal", lambda job, now: None)
    monkeypatch.setattr(BusCore, "lost", _forgets_nothing)
    monkeypatch.setattr("drivebus.bus.scheduler.Scheduler._stale", lambda scheduler, lane, job, now: False)
    here = stand(session, C320)
    for instant in range(40):
        run = here.wish(1, "run", 12.0)
        here.run(0.02 * instant)
        here.unplug()
        here.replug()
        here.finish(run)
        here.station(1).press_stop()
        here.run(20.0)
    assert found(session, "I10")


def _forgets_nothing(core: BusCore, error: Exception, now: float) -> list[Any]:
    """The port is gone, and what was queued stays queued."""
    core.is_open = False
    flight, core.flight = core.flight, None
    if flight is not None:
        core.scheduler.put(flight.job)
    out, core.out = core.out, []
    return out


def test_i11_a_read_that_acts(session: Session) -> None:
    here = stand(session)
    station = here.station(1)
    answer = station.answer

    def acts(message: Any, codec: Any) -> Any:
        station.setpoint_hz += 1.0
        return answer(message, codec)

    station.answer = acts
    here.monitor(1)
    here.run(1.0)
    assert found(session, "I11")


def test_i12_questions_that_are_remembered_for_ever(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    monkeypatch.setattr("drivebus.bus.aftermath._owed", lambda flight, now: kept.append((now, flight.job)))
    here = stand(session, weather="loss=0.1")
    here.bus.core.stations[1].unanswered = kept
    here.monitor(1)
    here.run(1500.0)
    here.close()
    assert found(session, "I12")


def test_i12_a_queue_that_nobody_empties(session: Session) -> None:
    here = stand(session)
    with running(here.loop):
        for _ in range(500):
            here.loop.create_task(here.drives[1].read(("F00.00",)))
    here.run(0.1)
    assert found(session, "I12")


def test_the_manuals_tables_know_every_request() -> None:
    """T01, T07, T16: what the observer's own tables say of frames from the manuals."""
    told = {
        ("c320", "ascii", "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D"): (0, Does.READ),
        ("c320", "ascii", "2A 30 30 34 31 31 30 33 45 37 30 31 44 35 0D"): (0, Does.MOVE),
        ("c320", "ascii", "2A 30 30 32 30 31 30 30 31 30 31 38 34 0D"): (0, Does.MOVE),
        ("c320", "ascii", "2A 31 46 34 32 31 30 30 30 30 30 31 43 45 0D"): (31, Does.STOP),
        ("c320", "hex", "5A 00 00 03 00 00 00 00 02 00 00 17 72 00 00 00 8E 0D"): (0, Does.SET),
        ("vc660", "rtu", "01 06 20 00 00 01 43 CA"): (1, Does.MOVE),
        ("vc660", "rtu", "01 06 20 00 00 02 03 CB"): (1, Does.STOP),
        ("vc660", "rtu", "01 06 20 00 00 84 00 00"): (1, Does.REST),
        ("df800", "rtu", "01 06 20 00 00 01 43 CA"): (1, Does.STOP),
        ("df800", "rtu", "01 06 20 00 00 0A 00 00"): (1, Does.MOVE),
        ("dzb100", "ascii", "43 03 01 30 31 30 31 30 30 36 34"): (1, Does.MOVE),
        ("dzb100", "ascii", "43 03 01 30 31 30 30 30 30 30 30"): (1, Does.STOP),
    }
    for (family, encoding, frame), meaning in told.items():
        assert request(family, encoding, bytes.fromhex(frame)) == meaning, frame


@pytest.mark.parametrize(
    "frame", ["2A 30 30 37 30 30 30 30 30 30 31 38 31 0D", "2A 30 30 31 32 32 30 30 30 30 31 38 31 0D"]
)
def test_the_manuals_tables_refuse_what_no_manual_knows(frame: str) -> None:
    with pytest.raises(ValueError):
        request("c320", "ascii", bytes.fromhex(frame))


def test_i8_what_escapes_from_a_command_is_found(session: Session) -> None:
    async def fails() -> None:
        raise RuntimeError("not ours")

    here = stand(session)
    here.finish(here.wish_by(fails, 1, "run"))
    assert found(session, "I8")


def test_a_lease_that_is_renewed_lives_on_the_loop_of_the_laboratory(session: Session) -> None:
    async def jog() -> Any:
        async with here.drives[1].jog() as lease:
            for _ in range(3):
                await asyncio.sleep(0.3)
                lease.renew()
        return lease.begun

    here = stand(session)
    wish = here.wish_by(jog, 1, "jog")
    here.finish(wish)
    assert wish.word == "acknowledged" and session.violations == []
