"""Stop: sent without a permit, repeated until confirmed, never reported as done by mistake."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.bus import TraceEvent, TraceKind
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority
from drivebus.bus.station import Station
from drivebus.drives import create_dialect
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.stop import (
    MAX_DECELERATION_S,
    MAX_FIRST_FRAMES,
    MIN_TIMEOUT_TRANSACTIONS,
    STOP_PROGRESS_TIMEOUT_S,
    STOP_RESEND_INTERVAL_S,
    StopProgress,
    send_stop,
    stop,
    timeout_transactions,
    unconfirmed_outcome,
)
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveState
from drivebus.drives.stop_supervisor import MIN_SUSPENSION_S, STOP_REPEAT_INTERVAL_S
from drivebus.errors import HeaderError, NoReply, NotPermitted, PortLost, StopUnconfirmed, Superseded
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.motor import Motor
from drivebus.values import bilingual_text
from fixtures.drives import (
    SAFE_HZ,
    FakeC320,
    FakeModbus,
    PureBus,
    SimulatedDrives,
    dialect_for,
    operation_for,
    run_virtual,
)

ROOT = Path(__file__).resolve().parents[2]


def c320(fake: FakeC320) -> PureBus:
    return PureBus(dialect=dialect_for("c320"), station=fake)


def stops(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
    fake.state = sunfar.SunfarState.STOPPED
    return fake.ok()


def test_a_stop_has_stop_priority_no_permit_and_no_read_before_it() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    first = bus.requests[0]
    assert isinstance(first.request, sunfar.SunfarControl)
    assert (first.priority, first.permit, first.expires_at) == (RequestPriority.STOP, None, None)
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.stop_confirmed")


def test_the_reads_of_an_operation_have_the_priority_of_a_stop_until_its_stop_has_ended() -> None:
    """Never that of a command, which a stop removes from the queue."""
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops))
    op = operation_for(bus.dialect)
    for operation, priority in (
        (op.read_verified_state(), RequestPriority.PARAMETER),
        (stop(op), RequestPriority.STOP_READ),
        (op.read_verified_state(), RequestPriority.PARAMETER),
    ):
        bus.requests.clear()
        bus.run(operation)
        reads = [ask for ask in bus.requests if not isinstance(ask.request, sunfar.SunfarControl)]
        assert {ask.priority for ask in reads} == {priority}


def test_the_levels_after_a_stop_pulse_have_a_lower_priority_than_other_stops() -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus())
    bus.run(stop(operation_for(bus.dialect)))
    pulse, levels, *_ = (ask for ask in bus.requests if isinstance(ask.request, modbus.WriteRegister))
    assert (pulse.priority, levels.priority) == (RequestPriority.STOP, RequestPriority.COMMAND)


def test_a_stop_is_not_confirmed_by_its_own_reply() -> None:
    """The drive accepts the stop and keeps running."""
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_unconfirmed")


def test_a_stop_that_is_not_confirmed_names_what_the_drive_reported_and_in_how_many_reads() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=2500))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    rounds = len(bus.sent(sunfar.ReadMonitor))
    assert rounds > 8 and f"the drive still reported running at 25.0 Hz (reads: {rounds})" in outcome.text("en")


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100"])
def test_a_stop_that_ends_in_the_middle_of_a_read_keeps_what_the_drive_reported(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The deadline of a stop cancels its reads; the state that was read before is still the evidence."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model], wait=model != "dzb100")
            monkeypatch.setattr(Motor, "stop", lambda *given: None)
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            outcome = caught.value.outcome
            assert (outcome.key, outcome.params["state"]) == ("drives.stop_unconfirmed", DriveState.RUNNING)
            assert outcome.params["reads"] > 4 and outcome.drive_status.state is DriveState.RUNNING
            monkeypatch.undo()

    run_virtual(scenario())


def test_a_drive_that_falls_silent_during_a_stop_is_reported_with_its_last_state() -> None:
    fake = FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=2500)
    bus = c320(fake)
    bus.on_request = lambda ask: setattr(fake, "silent", bus.now > 1.0)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.key == "drives.stop_reply_lost" and outcome.params["failures"] > 1
    assert "the drive reported running at 25.0 Hz, then gave no valid reply" in outcome.text("en")


def test_an_unconfirmed_stop_is_declared_within_two_seconds_of_no_progress() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    bus.run(stop(operation_for(bus.dialect)))
    assert STOP_PROGRESS_TIMEOUT_S < bus.now < STOP_PROGRESS_TIMEOUT_S + 0.5


def test_a_lost_stop_is_sent_again_at_once() -> None:
    lost = [1, 1]

    def third(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else stops(fake, request)

    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=third))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 3


def test_no_state_of_the_host_withholds_a_stop() -> None:
    from dataclasses import replace

    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops))
    bus.conditions = replace(
        bus.conditions, start_inhibited=True, foreign_master=True, duplicate_address=True, damage_rate=0.9, damaged=99
    )
    assert bus.run(stop(operation_for(bus.dialect))).status is OutcomeStatus.CONFIRMED


@pytest.mark.parametrize("state", [sunfar.SunfarState.FAULT, sunfar.SunfarState.NOT_READY])
def test_a_fault_or_an_uncharged_dc_bus_ends_a_stop_with_its_own_message(state: sunfar.SunfarState) -> None:
    bus = c320(FakeC320(state=state, fault_code=4))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.output_off")


@pytest.mark.parametrize("confirms", [True, False])
@pytest.mark.parametrize("state", [sunfar.SunfarState.FAULT, sunfar.SunfarState.NOT_READY, sunfar.SunfarState.STOPPED])
def test_only_a_fault_or_an_uncharged_dc_bus_confirms_a_stop_against_its_dialect(
    state: sunfar.SunfarState, confirms: bool
) -> None:
    """A motor at standstill whose last command was a start is not stopped; one without output is."""
    bus = c320(FakeC320(state=state, fault_code=4))
    bus.dialect.confirms_stop = lambda readings: confirms  # type: ignore[method-assign]
    outcome = bus.run(stop(operation_for(bus.dialect)))
    confirmed = confirms or state is not sunfar.SunfarState.STOPPED
    assert (outcome.status is OutcomeStatus.CONFIRMED) is confirmed


def test_a_model_without_a_run_status_is_confirmed_by_its_frequency_and_says_so() -> None:
    dialect = create_dialect(profiles.load("huanyang_hy"), 1)
    simulated = make_station("huanyang_hy", 1)
    bus = PureBus(dialect=dialect, station=lambda request: simulated.handle_request(request, dialect.codec))
    outcome = bus.run(stop(operation_for(dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.stop_confirmed_by_frequency")


def test_an_emergency_stop_state_confirms_a_quick_stop() -> None:
    def quick(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        assert request.operation is sunfar.SunfarOperation.EMERGENCY_STOP
        fake.state = sunfar.SunfarState.EMERGENCY_STOP
        return fake.ok()

    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=quick))
    assert bus.run(stop(operation_for(bus.dialect), StopMode.QUICK_STOP)).key == "drives.stop_confirmed"


def test_a_drive_that_slows_down_is_given_its_time() -> None:
    """The ramp of C320 is not published: a falling frequency is progress."""

    class Ramps(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.SunfarControl):
                self.state = sunfar.SunfarState.DECELERATING_FORWARD
            if isinstance(request, sunfar.ReadMonitor) and self.state == sunfar.SunfarState.DECELERATING_FORWARD:
                self.output = max(0, self.output - 20)
                self.state = self.state if self.output else sunfar.SunfarState.STOPPED
            return super().__call__(request)

    bus = c320(Ramps(state=sunfar.SunfarState.RUNNING_FORWARD, output=2000))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert bus.now > 2 * STOP_PROGRESS_TIMEOUT_S


def stop_intervals(bus: PureBus, op: OperationContext) -> list[float]:
    """Stop the drive; return the times between the ends of its stops."""
    times: list[float] = []
    bus.on_request = lambda ask: times.append(bus.now) if isinstance(ask.request, sunfar.SunfarControl) else None
    bus.run(stop(op))
    return [later - earlier for earlier, later in pairwise(times)]


def test_a_decelerating_drive_gets_the_stop_again_every_half_second() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD))
    intervals = stop_intervals(bus, operation_for(bus.dialect))
    assert len(intervals) > 100
    assert min(intervals) >= STOP_RESEND_INTERVAL_S == 0.5 and max(intervals) < STOP_RESEND_INTERVAL_S + 0.3


def test_while_the_bus_holds_reads_back_an_earlier_state_confirms_no_stop() -> None:
    """The stop is repeated each half second, and the fault that was read before it is no evidence."""
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    bus.conditions = replace(bus.conditions, reads_wait_until=60.0)
    op = operation_for(bus.dialect)
    op.derived = DerivedState(DriveState.FAULT)
    intervals = stop_intervals(bus, op)
    assert bus.sent(sunfar.ReadMonitor) == [] and len(intervals) >= 3
    assert min(intervals) >= STOP_RESEND_INTERVAL_S and max(intervals) < STOP_RESEND_INTERVAL_S + 0.15
    outcome = unconfirmed_outcome(op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_no_reply")


def test_only_the_reads_of_a_stop_give_up_where_the_bus_begins_to_hold_them_back() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops))
    op, waits = operation_for(bus.dialect), []
    bus.on_request = lambda ask: waits.append(op.waits_in_quarantine)
    bus.run(stop(op))
    assert waits[0] is True and set(waits[1:]) == {False} and op.waits_in_quarantine is True


@pytest.mark.parametrize("model", ["c320", "df800"])
@pytest.mark.parametrize("read_queued", [False, True])
def test_a_stop_is_repeated_while_the_bus_holds_reads_back(
    model: str, read_queued: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bus holds them for 5 s where a late reply could pass for theirs; both first stops may have been lost.

    ``read_queued``: the hold begins with the reply to the sync probe for which the read of the stop waits already.
    """
    if read_queued:
        monkeypatch.setattr("drivebus.bus.core._matches_older_request", lambda transaction: True)

    async def scenario() -> list[float]:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model])
            station = bench.bus.core.stations[1]
            bench.bus.core.scheduler.mark_suspect(station, bench.bus.now())
            station.quarantined_until = bench.bus.now() + (0.0 if read_queued else 5.0)
            stops: list[float] = []
            bench.bus.trace(lambda event: stops.append(event.time) if is_stop(station, event) else None)
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            return [later - at for at, later in pairwise([*stops, bench.bus.now()])]

    intervals = run_virtual(scenario())
    assert len(intervals) >= 3 and max(intervals) < STOP_RESEND_INTERVAL_S + 0.15


def is_stop(station: Station, event: TraceEvent) -> bool:
    return event.kind is TraceKind.SENT and station.config.effect_of(event.data) is Effect.STOP


def test_a_stop_to_an_offline_drive_is_repeated_and_reported() -> None:
    bus = c320(FakeC320(silent=True))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.key == "drives.stop_no_reply"
    assert len(bus.sent(sunfar.SunfarControl)) >= 3
    assert all(e.received == b"" for e in outcome.exchanges)


class RejectsReads(FakeC320):
    """Rejects every read of a signal, with response 6."""

    def __call__(self, request: Any) -> Any:
        if isinstance(request, sunfar.ReadMonitor):
            return sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse.BAD_CODE)
        return super().__call__(request)


STRAY = HeaderError("bus.stray_before", station=1, count=1, bytes="FF")
LATE = NoReply("bus.late_reply", station=1, milliseconds=300)


@pytest.mark.parametrize(
    ("model", "station", "why"),
    [
        ("c320", RejectsReads(), bilingual_text("drives.sunfar_response_6")),
        ("c320", lambda request: STRAY, bilingual_text(STRAY.key, **STRAY.params)),
        ("c320", lambda request: LATE, bilingual_text(LATE.key, **LATE.params)),
        ("df800", lambda request: STRAY, bilingual_text(STRAY.key, **STRAY.params)),
    ],
)
def test_replies_without_a_state_are_named_and_not_called_no_reply(model: str, station: Any, why: Any) -> None:
    """The hint of a drive that rejected each read, or replied with a stray byte, was to look whether it answers."""
    bus = PureBus(dialect=dialect_for(model), station=station)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_unusable_replies")
    assert outcome.params["why"] == why
    for language, remedies in (("en", ("no two drives", "repeater", "wiring")), ("zh", ("同一站号", "中继器", "接线"))):
        assert all(remedy in i18n.text("hint.drives.stop_unusable_replies", language) for remedy in remedies)


@pytest.mark.parametrize("error", [STRAY, LATE], ids=["stray", "late"])
def test_a_stop_of_df800_names_the_replies_to_its_reads_that_are_not_accepted(error: Exception) -> None:
    """Regression: the outcome named no reply at all. No stop is answered here, only the reads between them."""

    def station(request: Any) -> Any:
        return None if isinstance(request, modbus.WriteRegister) else error

    outcome = PureBus(dialect=dialect_for("df800"), station=station).run(stop(operation_for(dialect_for("df800"))))
    assert outcome.key == "drives.stop_unusable_replies"
    assert outcome.params["why"] == bilingual_text(error.key, **error.params)  # type: ignore[attr-defined]


def test_a_stop_whose_drive_reported_a_state_names_the_replies_that_were_not_accepted() -> None:
    """Regression: where a drive answers twice, the hint called its wiring right and the outcome named no cause."""

    class AnswersTwice(FakeC320):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            return STRAY if isinstance(request, sunfar.SunfarControl) else reply

    why = bilingual_text(STRAY.key, **STRAY.params)
    bus = c320(AnswersTwice(state=sunfar.SunfarState.RUNNING_FORWARD))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.key, outcome.notes) == ("drives.stop_unconfirmed", (("drives.unusable_replies", {"why": why}),))
    answered = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    assert answered.run(stop(operation_for(answered.dialect))).notes == ()
    for language, wrong in (("en", "wiring"), ("zh", "接线")):
        assert wrong not in i18n.text("hint.drives.stop_contradicted", language)


def test_one_reading_of_standstill_is_not_enough() -> None:
    """Two out of two: a single flipped status must not end a stop."""
    flips = [sunfar.SunfarState.STOPPED, sunfar.SunfarState.RUNNING_FORWARD]

    class Flips(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.ReadMonitor):
                flips.reverse()
                self.state = flips[0]
            return super().__call__(request)

    bus = c320(Flips())
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.UNKNOWN
    assert outcome.key in ("drives.stop_contradicted", "drives.stop_unconfirmed")


def test_without_waiting_an_answered_stop_is_unconfirmed() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    outcome = bus.run(stop(operation_for(bus.dialect), wait_confirmed=False))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_answered")
    assert len(bus.requests) == 1
    silent = c320(FakeC320(silent=True))
    outcome = silent.run(stop(operation_for(silent.dialect), wait_confirmed=False))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_unanswered")


def test_a_stop_of_df800_is_sent_three_times_and_never_confirmed() -> None:
    fake, times = FakeModbus(), list[float]()
    bus = PureBus(dialect=dialect_for("df800"), station=fake, on_request=lambda ask: times.append(bus.now))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.stop_acknowledged")
    assert fake.written == [(0x2000, 1)] * 3
    assert times == pytest.approx([0.0, 0.08, 0.16]), "no read delays a stop that was answered"


@pytest.mark.parametrize("answered", range(3))
def test_a_df800_that_answers_one_of_its_stops_has_accepted_it(answered: int) -> None:
    """Until then a read goes between them: the reply mirrors the stop, as an echo does."""

    class AnswersOnce(FakeModbus):
        stops = 0

        def __call__(self, request: Any) -> Any:
            if not isinstance(request, modbus.WriteRegister):
                return super().__call__(request)
            self.stops += 1
            return super().__call__(request) if self.stops == answered + 1 else None

    bus = PureBus(dialect=dialect_for("df800"), station=AnswersOnce())
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.stop_acknowledged")
    sent = [isinstance(ask.request, modbus.WriteRegister) for ask in bus.requests]
    assert sent.count(True) == 3 and sent.count(False) == min(answered, 2)


def test_a_silent_df800_is_unconfirmed() -> None:
    bus = PureBus(dialect=dialect_for("df800"), station=FakeModbus(silent=True))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_no_reply")


def test_vc660_writes_the_levels_after_each_stop_pulse_so_that_a_repeated_stop_acts() -> None:
    """The drive acts on the edge only, and the first pulse is lost: the second must have an edge again."""
    last = [0]

    def edge(fake: FakeModbus, word: int) -> bool:
        fresh = word & ~last[0]
        last[0] = word
        if fresh & 2:
            fake.registers[0x3000] = 0x0001
        return True

    fake = FakeModbus(registers={0x3000: 0x0009}, on_command=edge)
    last[0] = 2
    bus = PureBus(dialect=dialect_for("vc660"), station=fake)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert [value for _, value in fake.written][:3] == [0x0002, 0x0000, 0x0002]


def test_dzb100_is_stopped_when_q01_reads_zero_twice_and_q03_repeats_the_stop() -> None:
    class FakeDzb100:
        def __init__(self, output: int, state: int) -> None:
            self.output, self.state = output, state

        def __call__(self, request: Any) -> Any:
            if isinstance(request, dzb100.Dzb100Control):
                return dzb100.Dzb100Reply(head="C", address=1, index=request.index, data=0, accepted=True)
            if isinstance(request, dzb100.Dzb100ReadParameter):
                return dzb100.Dzb100Reply(head="R", address=1, index=request.index, data=0, accepted=True)
            data = {1: self.output, 3: self.state}[request.item]
            return dzb100.Dzb100Reply(head="Q", address=1, index=request.item, data=data, accepted=True)

    for output, state, word in ((0, 0x0000, "confirmed"), (0, 0x1000, "unknown"), (5, 0x0000, "unknown")):
        bus = PureBus(dialect=dialect_for("dzb100"), station=FakeDzb100(output, state))
        assert bus.run(stop(operation_for(bus.dialect))).status == word


@pytest.mark.parametrize(("key", "output_hz"), [("drives.reported_at", 25.0), ("drives.reported", None)])
def test_a_stop_without_effect_names_the_last_report_with_a_frequency_only_where_one_was_read(
    key: str, output_hz: float | None
) -> None:
    profile = profiles.load("vc660")
    hidden = () if output_hz is not None else ("output_frequency",)
    profile = replace(profile, signals={name: signal for name, signal in profile.signals.items() if name not in hidden})
    registers = {0x3000: 0x0009, 0x3002: 2500}
    bus = PureBus(dialect=create_dialect(profile, 1), station=FakeModbus(registers=registers))
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.params["found"] == bilingual_text(key, state=DriveState.RUNNING, output_hz=output_hz)
    assert outcome.key == "drives.stop_unconfirmed"


def test_each_lower_reading_is_progress_where_a_verified_state_takes_longer_than_the_timeout() -> None:
    """A DZB100 that decelerates from 30 Hz within 3 s and has no readable ramp, on a bus with many other drives."""

    def slowing(request: Any) -> Any:
        if isinstance(request, dzb100.Dzb100Control):
            return dzb100.Dzb100Reply(head="C", address=1, index=request.index, data=0, accepted=True)
        if isinstance(request, dzb100.Dzb100ReadParameter):
            return dzb100.Dzb100Reply(head="R", address=1, index=request.index, data=0, accepted=True)
        output = max(0, round(300 - 100 * bus.now))
        return dzb100.Dzb100Reply(
            head="Q",
            address=1,
            index=request.item,
            data={1: output, 3: 0x0100 * (output > 0)}[request.item],
            accepted=True,
        )

    class Crowded(PureBus):
        def transact(self, ask: BusRequest) -> BusResult:
            self.pass_time(0.35)
            return super().transact(ask)

    bus = Crowded(dialect=dialect_for("dzb100"), station=slowing)
    assert bus.run(stop(operation_for(bus.dialect))).status is OutcomeStatus.CONFIRMED
    assert bus.now > STOP_PROGRESS_TIMEOUT_S + 3.0


def test_superseded_reads_do_not_end_a_stop() -> None:
    """Two stops at once supersede each other's reads: both continue."""
    taken = [1, 1, 1]

    class Taken(FakeC320):
        def __call__(self, request: Any) -> Any:
            if not isinstance(request, sunfar.SunfarControl) and taken:
                taken.pop()
                return Superseded("bus.superseded", station=1)
            return super().__call__(request)

    bus = c320(Taken(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops))
    assert bus.run(stop(operation_for(bus.dialect))).status is OutcomeStatus.CONFIRMED


def test_a_rejected_stop_of_a_modbus_drive_counts_as_unanswered() -> None:
    bus = PureBus(dialect=dialect_for("df800"), station=FakeModbus(rejections={0x2000: None}))
    silent = bus.run(stop(operation_for(bus.dialect)))
    assert silent.key == "drives.stop_rejected" and "the drive rejected the request" in silent.text("en")
    running = PureBus(dialect=dialect_for("vc660"), station=FakeModbus({0x3000: 0x0009}, rejections={0x2000: None}))
    outcome = running.run(stop(operation_for(running.dialect)))
    assert outcome.key == "drives.stop_rejected_running"
    assert "the drive rejected" in outcome.text("en") and "still reported running" in outcome.text("en")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_only_next_step_after_a_rejected_stop_is_the_hard_wired_one(language: str) -> None:
    """The next step after exception 4 was part of its meaning: to look whether the run forbids the stop."""
    station = FakeModbus({0x3000: 0x0009}, rejections={0x2000: 4})
    bus = PureBus(dialect=dialect_for("vc660"), station=station)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.key == "drives.stop_rejected_running" and not outcome.notes
    assert i18n.text("drives.modbus_remedy_4", language) not in outcome.text(language)
    assert "check" not in outcome.text("en")


def progress_of(
    *,
    transaction_s: float = inf,
    slowed_at: float | None = None,
    deceleration_s: float | None = None,
    others: Sequence[tuple[str, int]] = (),
) -> tuple[Any, StopProgress]:
    """Return an operation with this evidence, and the progress of its stop that began at 100 s.

    ``others``: models and addresses of drives of the bus that are stopped with it.
    """
    op: Any = SimpleNamespace(
        age=SimpleNamespace(fastest_transaction_s=transaction_s),
        drive=SimpleNamespace(deceleration_s=deceleration_s),
        dialect=create_dialect(profiles.load("c320"), 1),
        derived=DerivedState(DriveState.RUNNING),
        last_deceleration_at=slowed_at,
        sent_count=1,
        port_error=None,
    )
    joint = (op, *(operation_for(create_dialect(profiles.load(model), address)) for model, address in others))
    return op, StopProgress(op, 100.0, joint=joint)


@pytest.mark.parametrize(
    ("evidence", "deadline"),
    [
        ({}, 102.0),
        ({"transaction_s": 0.01}, 102.0),
        ({"transaction_s": 0.5}, 108.0),
        ({"transaction_s": 0.05, "others": [("c320", 2), ("dzb100", 3), ("df800", 4), ("c320", 2)]}, 104.8),
        ({"slowed_at": 110.0}, 112.0),
        ({"slowed_at": 110.0, "transaction_s": 0.5}, 118.0),
        ({"slowed_at": 300.0}, 220.0),
        ({"deceleration_s": 20.0}, 122.0),
        ({"deceleration_s": 20.0, "slowed_at": 110.0}, 122.0),
        ({"deceleration_s": 20.0, "slowed_at": 121.0}, 123.0),
        ({"deceleration_s": 300.0}, 402.0),
        ({"deceleration_s": 300.0, "slowed_at": 500.0}, 402.0),
    ],
)
def test_a_stop_has_the_time_of_its_ramp_its_bus_and_its_progress_but_no_more(
    evidence: dict[str, Any], deadline: float
) -> None:
    """A motor that never reaches 0 Hz is reported, and one with a long ramp is not reported too soon."""
    assert progress_of(**evidence)[1].deadline == pytest.approx(deadline)


@pytest.mark.parametrize(
    ("model", "transactions"),
    [("c320", 16), ("dzb100", 16), ("vc660", 16), ("df800", 16), ("eds800", 18), ("sv600", 22)],
)
def test_on_a_slow_bus_a_stop_has_the_time_of_two_verified_states_and_two_stops_of_its_model(
    model: str, transactions: int
) -> None:
    """Models with three or four state reads had that of two, and some that stood were reported as unconfirmed."""
    dialect = create_dialect(profiles.load(model), 1)
    assert timeout_transactions(dialect) == transactions
    verified_state = VERIFICATION_ROUNDS * (1 + len(dialect.state_reads()))
    assert transactions >= 2 * (verified_state + len(dialect.stop(StopMode.STOP)))


SECTION_OF_STOPS = {"en": "## How long a stop is repeated", "zh": "## 停机重复多久"}


@pytest.mark.parametrize("language", SECTION_OF_STOPS)
def test_the_page_about_stops_has_the_times_of_the_program(language: str) -> None:
    suffix = "" if language == "en" else ".zh"
    page = (ROOT / "docs" / "explanation" / f"bus-stop{suffix}.md").read_text(encoding="utf-8")
    section = page.partition(SECTION_OF_STOPS[language])[2].partition("\n## ")[0]
    seconds = [
        STOP_PROGRESS_TIMEOUT_S,
        STOP_RESEND_INTERVAL_S,
        STOP_REPEAT_INTERVAL_S,
        MAX_DECELERATION_S,
        MIN_SUSPENSION_S,
    ]
    most = max(timeout_transactions(create_dialect(profile, 1)) for profile in map(profiles.load, profiles.models()))
    numbers = [MIN_TIMEOUT_TRANSACTIONS, most, MAX_FIRST_FRAMES]
    stated = [*(f"{value:g} s" for value in seconds), *map(str, numbers)]
    assert [value for value in stated if re.search(rf"(?<!\d){re.escape(value)}(?!\d)", section) is None] == []


@pytest.mark.parametrize("state", DriveState)
@pytest.mark.parametrize("by_frequency", [False, True])
def test_a_reported_deceleration_or_dc_braking_is_progress(state: DriveState, by_frequency: bool) -> None:
    """A state that was derived from frequencies is none: they show each lower reading themselves."""
    op, progress = progress_of()
    op.derived = DerivedState(state, by_frequency=by_frequency)
    slows = state in (DriveState.DECELERATING, DriveState.BRAKING) and not by_frequency
    assert progress.update(105.0) is slows and progress.deadline == (107.0 if slows else 102.0)
    assert progress.update(105.0) is False


def test_a_lower_reading_is_progress_once() -> None:
    op, progress = progress_of()
    op.last_deceleration_at = 103.0
    assert progress.update(104.0) is True and progress.update(105.0) is False


def test_of_several_stops_one_is_reported_when_it_had_its_transactions_and_2_s_since_the_last_deceleration() -> None:
    op, progress = progress_of(transaction_s=0.5, others=[("c320", 2)])
    op.sent_count = 16
    assert progress.deadline == 124.0 and not progress.is_over(101.9) and progress.is_over(102.1)
    op.sent_count, op.last_deceleration_at = 20, 104.0
    progress.update(104.5)
    op.sent_count = 35
    assert not progress.is_over(110.0)
    op.sent_count = 36
    assert progress.is_over(110.0)
    op.derived = DerivedState(DriveState.UNKNOWN)  # its replies are lost, and stops take the place of reads
    assert not progress.is_over(110.0)
    op.sent_count = 44
    assert progress.is_over(110.0)


def test_no_stop_waits_for_others_where_the_port_is_lost() -> None:
    op, progress = progress_of(transaction_s=0.5, others=[("c320", 2)])
    assert progress.deadline == 124.0
    op.port_error = PortLost("ports.unplugged")
    assert progress.deadline == 102.0


@pytest.mark.parametrize(("readings", "decelerated_until"), [((3000, 1000, 0), 1.0), ((3000, 0), 0.5)])
def test_a_reading_of_0_hz_shows_deceleration_up_to_the_reading_before_it(
    readings: tuple[int, ...], decelerated_until: float
) -> None:
    """It restarted the 2 s until the report, however long the motor had been standing."""
    fake = FakeC320()
    bus = c320(fake)
    op = operation_for(bus.dialect)
    progress = StopProgress(op, bus.now)
    read_frequency = next(request for request in bus.dialect.state_reads() if isinstance(request, sunfar.ReadMonitor))
    for fake.output in readings:
        bus.pass_time(0.5)
        bus.run(op.read(read_frequency))
    assert progress.deadline == pytest.approx(decelerated_until + STOP_PROGRESS_TIMEOUT_S, abs=0.1)


def test_a_stop_that_another_operation_began_has_the_rest_of_its_time() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    op = operation_for(bus.dialect)
    begun = StopProgress(op, bus.now)
    bus.pass_time(1.5)
    bus.run(stop(op, progress=begun))
    assert STOP_PROGRESS_TIMEOUT_S < bus.now < STOP_PROGRESS_TIMEOUT_S + 0.5


@pytest.mark.parametrize("started", [True, False])
@pytest.mark.parametrize("confirmed", [True, False])
def test_a_motor_that_was_started_may_run_until_its_stop_is_confirmed(started: bool, confirmed: bool) -> None:
    """The error of a port that is lost meanwhile says so."""
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=stops if confirmed else None))
    op = operation_for(bus.dialect)
    op.may_be_running = started
    bus.run(stop(op))
    assert op.may_be_running is (started and not confirmed)


def test_an_unconfirmed_stop_shows_the_last_report_only_where_nothing_newer_was_found() -> None:
    bus = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    op = operation_for(bus.dialect)
    bus.run(stop(op))
    for derived, shown in (
        (STATE_NOT_READ, DriveState.RUNNING),
        (DerivedState(DriveState.UNKNOWN, reason="drives.no_answer"), DriveState.UNKNOWN),
    ):
        op.derived = derived
        status = unconfirmed_outcome(op).drive_status
        assert status is not None and status.state is shown


def test_a_stop_that_was_sent_is_not_reported_as_waiting_for_the_model() -> None:
    op = operation_for(create_dialect(profiles.load("gd10"), 1))
    op.stop_awaits_model = True
    assert unconfirmed_outcome(op).key == "drives.stop_awaits_model"
    op.stops_sent = 1
    assert unconfirmed_outcome(op).key == "drives.stop_no_reply"


def test_a_stop_is_not_reported_as_waiting_for_the_model_that_was_read() -> None:
    """The model has answered, and the stop itself was not sent: the reason is another one."""
    dialect = create_dialect(profiles.load("gd10"), 1)
    simulated = make_station("gd10", 1)
    bus = PureBus(dialect=dialect, station=lambda request: simulated.handle_request(request, dialect.codec))
    op = operation_for(dialect)
    assert bus.run(send_stop(op, StopMode.STOP)) is True and not op.stop_awaits_model


def test_a_stop_that_is_withheld_counts_as_not_accepted() -> None:
    dialect = create_dialect(profiles.load("gd10"), 1)
    bus = PureBus(dialect=dialect, station=lambda request: None)
    op = operation_for(dialect)
    assert bus.run(send_stop(op, StopMode.STOP)) is False
    assert op.withheld_stop is not None and not op.stop_awaits_model and bus.effects() == []


def test_a_stop_that_was_sent_to_a_drive_that_is_then_removed_is_unconfirmed() -> None:
    """Also where no read showed a state: its error was that nothing was sent."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            stop = asyncio.create_task(drive.stop())
            await asyncio.sleep(0.05)
            drive.close()
            with pytest.raises(StopUnconfirmed) as caught:
                await stop
            assert (caught.value.key, caught.value.params) == ("drives.stop_removed", {"sent": 1})
            assert caught.value.outcome.exchanges[0].received

    run_virtual(scenario())


def test_a_stop_that_waits_when_its_drive_is_removed_is_reported_as_not_sent() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "1-2") as bench:
            drive, other = bench.drive(1), bench.drive(2)
            stop, first = asyncio.create_task(drive.stop()), asyncio.create_task(other.stop())
            await asyncio.sleep(0)
            other.close()
            await stop
            with pytest.raises(NotPermitted, match="nothing was sent"):
                await first

    run_virtual(scenario())
