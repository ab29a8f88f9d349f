"""Start: sent once with a permit, confirmed by verified reads, resent only after reads that show standstill."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import create_dialect
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import Superseded, TargetNotReached
from drivebus.protocols import dzb100, sunfar
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, operation_for, reject_command
from fixtures.starts import c320, df800, start, starts, vc660

ON_320 = sunfar.SunfarOperation.RUN_FORWARD_AT


def test_a_start_is_one_frame_with_its_frequency_and_confirmed_by_later_reads() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.start_confirmed")
    assert bus.sent(sunfar.SunfarControl) == [sunfar.SunfarControl(1, ON_320, 1000)]
    assert outcome.exchanges[-1].sent_at is not None


@pytest.mark.parametrize(
    ("hz", "on_command", "is_noted"), [(0.0, starts, True), (1.0, starts, False), (0.0, None, False)]
)
def test_a_run_at_0_hz_that_succeeded_says_that_the_motor_does_not_turn(
    hz: float, on_command: Any, is_noted: bool
) -> None:
    outcome = start(*c320(FakeC320(on_command=on_command)), hz=hz)
    assert ("drives.run_at_zero" in dict(outcome.notes)) is is_noted


FASTER = sunfar.SunfarState.RUNNING_FORWARD


@pytest.mark.parametrize(
    ("shown", "state", "found_hz"),
    [
        ((1300, 1300), FASTER, None),
        ((1301, 1301), FASTER, 13.01),
        ((1400, 1500), FASTER, 15.0),
        ((1500, 1400), FASTER, None),
        ((1200, 1500), FASTER, None),
        ((1500, 1500), sunfar.SunfarState.ACCELERATING_FORWARD, 15.0),
        ((1500, 1500), sunfar.SunfarState.RESTARTING, None),
    ],
    ids=["tolerated", "too fast", "rising", "falling", "once", "accelerating", "caught by a speed search"],
)
@pytest.mark.parametrize("is_stoppable", [True, False])
def test_a_start_stops_a_drive_that_two_reads_show_too_fast(
    shown: tuple[int, int], state: int, found_hz: float | None, is_stoppable: bool
) -> None:
    """No wait for the speed is needed for that: 10 Hz was sent, 3 Hz more are tolerated."""

    def races(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = state if request.operation == ON_320 or not is_stoppable else sunfar.SunfarState.STOPPED
        return fake.ok()

    fake = FakeC320(on_command=races)
    bus, op = c320(fake)

    def show(ask: Any) -> None:
        if bus.effects():
            reads = len([sent for sent in bus.requests if isinstance(sent.request, sunfar.ReadMonitor)])
            fake.output = shown[reads % 2] if fake.state == state else 0

    bus.on_request = show
    if found_hz is None:
        assert start(bus, op).status is OutcomeStatus.CONFIRMED
        return
    with pytest.raises(TargetNotReached) as caught:
        start(bus, op)
    assert (caught.value.key, caught.value.params["found_hz"]) == ("drives.overspeed", found_hz)
    assert caught.value.outcome.status is (OutcomeStatus.FAILED if is_stoppable else OutcomeStatus.UNKNOWN)
    assert bus.sent(sunfar.SunfarControl, operation=sunfar.SunfarOperation.STOP)


def test_a_start_whose_reply_says_ok_is_not_confirmed_by_it() -> None:
    """The drive accepts and does not move: failed, never confirmed."""
    bus, op = c320(FakeC320())
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1
    assert 3.0 < bus.now < 4.0, "it has three seconds to report running"


def test_after_a_start_that_the_drive_ignored_the_next_one_reads_its_preconditions_again() -> None:
    bus, op = c320(FakeC320())
    start(bus, op)
    read = len(bus.sent(sunfar.SunfarReadParameter, group=0))
    assert start(bus, OperationContext(op.drive)).key == "drives.start_ignored"
    assert len(bus.sent(sunfar.SunfarReadParameter, group=0)) == 2 * read > 0


def test_a_start_after_which_the_readings_contradict_each_other_is_unknown() -> None:
    fake = FakeC320()
    bus, op = c320(fake)

    def flips(ask: Any) -> None:
        if bus.effects() and isinstance(ask.request, sunfar.ReadMonitor):
            fake.state = (
                sunfar.SunfarState.STOPPED if fake.state != sunfar.SunfarState.STOPPED else sunfar.SunfarState.FAULT
            )

    bus.on_request = flips
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")


def test_an_unanswered_start_is_resent_at_standstill_also_after_a_state_that_was_not_read() -> None:
    lost = [True]

    def first_is_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else starts(fake, request)

    fake = FakeC320(on_command=first_is_lost)
    bus, op = c320(fake)
    bus.on_request = lambda ask: setattr(fake, "silent", bool(bus.effects()) and bus.now < 0.8)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 2


def test_every_confirming_read_has_its_own_sync_probe_before_it() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    start(bus, op)
    place = next(i for i, ask in enumerate(bus.requests) if isinstance(ask.request, sunfar.SunfarControl))
    after = [ask.request for ask in bus.requests[place + 1 :]]
    assert [type(r) for r in after] == [sunfar.SunfarReadParameter, sunfar.ReadMonitor] * 2
    probes = [r for r in after if isinstance(r, sunfar.SunfarReadParameter)]
    assert all(f.group != 0 for f in probes)
    assert probes[0] != probes[1]


def test_an_unanswered_start_is_resent_after_two_verified_reads_show_standstill() -> None:
    lost = [True]

    def first_is_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else starts(fake, request)

    bus, op = c320(FakeC320(on_command=first_is_lost))
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.CONFIRMED
    places = [i for i, ask in enumerate(bus.requests) if isinstance(ask.request, sunfar.SunfarControl)]
    assert len(places) == 2
    between = [type(ask.request) for ask in bus.requests[places[0] + 1 : places[1]]]
    assert between == [sunfar.SunfarReadParameter, sunfar.ReadMonitor] * 2


def test_a_start_whose_reply_was_lost_is_not_sent_twice() -> None:
    """Executed, the reply lost: the reads show running and nothing is repeated."""

    def reply_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_FORWARD

    bus, op = c320(FakeC320(on_command=reply_lost))
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 1


@pytest.mark.parametrize(
    ("then", "key"),
    [
        (sunfar.SunfarState.STOPPED, "drives.started_and_stopped"),
        (sunfar.SunfarState.FAULT, "drives.started_and_tripped"),
        (sunfar.SunfarState.NOT_READY, "drives.started_and_tripped"),
    ],
)
def test_a_stop_at_the_keypad_is_never_undone_and_a_trip_is_not_called_one(then: sunfar.SunfarState, key: str) -> None:
    """Running was seen once after the unanswered start; then a person stops the drive, or it trips: no resend."""
    reads = []

    def reply_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_FORWARD

    fake = FakeC320(on_command=reply_lost)
    bus, op = c320(fake)

    def person(ask: Any) -> None:
        if isinstance(ask.request, sunfar.ReadMonitor) and fake.state == sunfar.SunfarState.RUNNING_FORWARD:
            reads.append(ask)
            fake.state, fake.fault_code = then, 7 if then is sunfar.SunfarState.FAULT else fake.fault_code

    bus.on_request = person
    outcome = start(bus, op)
    assert reads
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, key)
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_an_unanswered_start_is_not_resent_once_it_is_two_seconds_old() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))
    bus.silence_s = 2.1
    outcome = start(bus, op)
    assert outcome.status is not OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_an_unanswered_start_is_sent_three_times_at_most() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))
    bus.silence_s = bus.transaction_s = 0.001
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.FAILED
    assert len(bus.sent(sunfar.SunfarControl)) == 3


def test_a_stop_that_comes_while_a_start_waits_to_be_confirmed_ends_it() -> None:
    """The stop increments the stop epoch; the start is superseded and not resent."""
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def stop_comes(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            bus.count_stop()

    bus.on_request = stop_comes
    with pytest.raises(Superseded) as caught:
        start(bus, op)
    assert caught.value.outcome.status is OutcomeStatus.UNKNOWN
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_withdrawn_start_without_reply_is_not_resent_and_its_effect_is_still_read() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def is_withdrawn(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            op.drive.withdrawal = Superseded("drives.superseded")

    bus.on_request = is_withdrawn
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_drive_that_falls_silent_after_the_start_leaves_the_outcome_unknown() -> None:
    def dies(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.silent = True

    bus, op = c320(FakeC320(on_command=dies))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_rejected_start_is_refused() -> None:
    bus, op = c320(FakeC320(on_command=reject_command))
    outcome = start(bus, op)
    assert (outcome.status, outcome.params["code"]) == (OutcomeStatus.REFUSED, 1)


def test_a_drive_that_trips_on_the_start_did_not_start() -> None:
    def trips(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state, fake.fault_code = sunfar.SunfarState.FAULT, 7
        return fake.ok()

    bus, op = c320(FakeC320(on_command=trips))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed")
    assert bus.now < 1.0
    [(key, params)] = outcome.notes
    assert (key, params["fault"].en) == ("drives.fault_named", "fault Fu.7: see the fault table of the C320 manual")
    assert (
        outcome.drive_status is not None
        and outcome.drive_status.fault is not None
        and outcome.drive_status.fault.code == 7
    )


def test_a_drive_that_trips_while_it_accelerates_is_reported_as_not_running() -> None:
    """It turned for 0.15 s and reported an over-current while accelerating: "the drive did not start"."""

    def accelerates_and_trips(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.ACCELERATING_FORWARD
        reply = fake.ok()
        fake.state, fake.fault_code = sunfar.SunfarState.FAULT, 7
        return reply

    bus, op = c320(FakeC320(on_command=accelerates_and_trips))
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.FAILED
    assert outcome.text("en") == "the drive does not run: it reports fault"
    assert outcome.text("zh") == "变频器未运行：报告故障"


@pytest.mark.parametrize("state", [sunfar.SunfarState.NOT_READY, sunfar.SunfarState.EMERGENCY_STOP])
def test_a_drive_without_supply_or_in_emergency_stop_after_the_start_is_reported_at_once(state: int) -> None:
    def refuses(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = state
        return fake.ok()

    bus, op = c320(FakeC320(on_command=refuses))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed") and bus.now < 1.0


@pytest.mark.parametrize("direction", [None, Direction.FORWARD])
def test_a_drive_that_turns_the_other_way_is_a_failure(direction: Direction | None) -> None:
    """A start without a direction is a start forward."""

    def wrong(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_REVERSE
        return fake.ok()

    bus, op = c320(FakeC320(on_command=wrong))
    outcome = start(bus, op, direction=direction)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.wrong_direction")


def test_vc660_that_reports_reverse_after_a_plain_start_is_a_failure() -> None:
    def wrong(fake: FakeModbus, word: int) -> bool:
        fake.registers[0x3000] = 0xC009
        return True

    bus, op = vc660(FakeModbus(on_command=wrong))
    outcome = start(bus, op)
    assert (outcome.key, outcome.params["expected"]) == ("drives.wrong_direction", Direction.FORWARD)


def test_a_drive_without_a_readable_setpoint_is_confirmed_without_a_note_about_it() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    assert start(bus, op).notes == ()


def test_a_model_that_shows_neither_set_nor_output_frequency_is_confirmed_with_a_note_about_it() -> None:
    profile = profiles.load("c320")
    hidden = {name: signal for name, signal in profile.signals.items() if name != "output_frequency"}
    dialect = create_dialect(replace(profile, signals=hidden), 1, options={"setpoint_step": "0.01"})
    bus = PureBus(dialect=dialect, station=FakeC320(on_command=starts))
    outcome = start(bus, operation_for(dialect))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert outcome.notes == (("drives.setpoint_not_shown", {"frequency_hz": 10.0}),)


def test_a_resend_that_is_not_allowed_any_more_does_not_hide_that_the_start_was_sent() -> None:
    """StartInhibited means that nothing was sent. Two reads showed standstill, so the start is known to have failed."""
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def seen(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            bus.conditions = replace(bus.conditions, duplicate_address=True)

    bus.on_request = seen
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_what_follows_a_pulse_may_be_withheld_without_hiding_the_pulse() -> None:
    """VC660: another drive shows up at its address between the pulse and its end; the start has left."""
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)

    def seen(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2000:
            bus.conditions = replace(bus.conditions, duplicate_address=True)

    bus.on_request = seen
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_the_end_of_a_pulse_that_expires_does_not_hide_the_pulse() -> None:
    """VC660: the reply to its pulse took longer than a start may be old."""
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)
    bus.on_request = lambda ask: bus.pass_time(2.1 if getattr(ask.request, "register", 0) == 0x2000 else 0.0)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_a_stop_between_a_pulse_and_its_end_leaves_a_start_of_which_the_outcome_is_unknown() -> None:
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)

    def stop_comes(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2000:
            bus.count_stop()

    bus.on_request = stop_comes
    with pytest.raises(Superseded) as caught:
        start(bus, op)
    assert caught.value.outcome.status is OutcomeStatus.UNKNOWN
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_an_unanswered_pulse_of_vc660_is_not_repeated_when_the_drive_runs() -> None:
    def obeys_silently(fake: FakeModbus, word: int) -> bool:
        if word & 1:
            fake.registers[0x3000] = 0x0009
            return False
        return True

    fake = FakeModbus(on_command=obeys_silently)
    bus, op = vc660(fake)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert [value for register, value in fake.written if register == 0x2000] == [0x0001, 0x0000]


def test_df800_is_started_on_its_preflight_and_only_acknowledged() -> None:
    fake = FakeModbus()
    bus, op = df800(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.start_acknowledged")
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0002)]
    assert outcome.drive_status is not None and outcome.drive_status.state == "unknown"


def test_an_unanswered_start_of_df800_is_never_resent() -> None:
    fake = FakeModbus(on_command=lambda fake, word: False)
    bus, op = df800(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")
    assert [value for register, value in fake.written if register == 0x2000] == [0x0002]


def test_modbus_errors_of_the_drive_are_refusals() -> None:
    bus, op = df800(FakeModbus(rejections={0x2000: None}))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.REFUSED, "drives.start_refused")
    assert "no such parameter, or it is locked" in outcome.text("en")


KEYPAD_DZB100 = {0: 2, 1: 3}  # frequency and commands from RS485


@dataclass
class FakeDzb100:
    """Fake DZB100: answers reads and queries, and takes each command unless ``on_command`` is another one."""

    items: dict[int, int] = field(default_factory=dict)
    on_command: Callable[[FakeDzb100, dzb100.Dzb100Control], bool] = lambda fake, request: True

    def __call__(self, request: Any) -> Any:
        if isinstance(request, dzb100.Dzb100Control):
            self.items |= {0: request.data, 1: request.data, 3: request.command << 12}
            if not self.on_command(self, request):
                return None
        if isinstance(request, dzb100.Dzb100Query):
            data = self.items.get(request.item, 0)
        else:
            data = (
                KEYPAD_DZB100.get(request.index, 0) if isinstance(request, dzb100.Dzb100ReadParameter) else request.data
            )
        return dzb100.Dzb100Reply(head=chr(request.head), address=1, index=request.index, data=data, accepted=True)


def start_dzb100(fake: FakeDzb100, **options: Any) -> tuple[PureBus, Outcome]:
    bus = PureBus(dialect=dialect_for("dzb100", **options), station=fake)
    return bus, start(bus, operation_for(bus.dialect), hz=0.5)


@pytest.mark.parametrize("is_shown", [True, False])
def test_the_frequency_of_a_dzb100_is_read_back_after_its_start_and_a_note_says_where_it_is_not_shown(
    is_shown: bool,
) -> None:
    def executes(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[0] = request.data if is_shown else 0x7777
        return True

    bus, outcome = start_dzb100(FakeDzb100(on_command=executes))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert ("drives.setpoint_not_shown" in dict(outcome.notes)) is not is_shown
    assert outcome.exchanges[-1].sent == bus.dialect.codec.encode_request(bus.requests[-1].request)


def test_the_frequency_of_a_start_that_a_dzb100_ignored_is_not_read_back() -> None:
    def ignores(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items.clear()
        return True

    _, outcome = start_dzb100(FakeDzb100(on_command=ignores))
    assert (outcome.status, outcome.key, outcome.notes) == (OutcomeStatus.FAILED, "drives.start_ignored", ())


def test_an_unanswered_start_that_a_dzb100_shows_as_its_last_command_is_not_resent() -> None:
    """It has executed the start and was stopped at its keypad since."""

    def is_stopped_at_once(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[1] = 0
        return False

    bus, outcome = start_dzb100(FakeDzb100(on_command=is_stopped_at_once))
    assert outcome.status is OutcomeStatus.FAILED
    assert len(bus.sent(dzb100.Dzb100Control)) == 1


def test_a_frequency_of_a_dzb100_whose_coding_is_not_determined_stops_nothing() -> None:
    """The quality of such a frequency is uncertain: 100 may be 100 Hz, 10 Hz or 1 Hz."""

    def shows_another_coding(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[1] = 0x1000
        return True

    bus, outcome = start_dzb100(FakeDzb100(on_command=shows_another_coding))
    assert outcome.status is OutcomeStatus.CONFIRMED and len(bus.sent(dzb100.Dzb100Control)) == 1
