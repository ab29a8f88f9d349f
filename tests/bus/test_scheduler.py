"""Choice of the next frame by the scheduler alone, one decision at a time."""

from __future__ import annotations

from math import inf
from typing import Any

import pytest

from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy
from drivebus.bus.prepared_request import Poll, PreparedPoll, PreparedRequest
from drivebus.bus.scheduler import MAX_COMMANDS_IN_ROW, MAX_POLLS_IN_ROW, PollSchedule, Scheduler
from drivebus.bus.station import Station
from drivebus.errors import Expired, NotPermitted
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from fixtures.bus import COMMAND, SETTINGS, START, STOP, read, station_config

SPEED = 0x2001


def station(address: int = 1) -> Station:
    return Station(station_config(address), SETTINGS)


def make_read(target: Station, priority: RequestPriority = RequestPriority.PARAMETER, **more: Any) -> PreparedRequest:
    return PreparedRequest(
        BusRequest(station=target.address, request=read(target.address), priority=priority, **more),
        "token",
        target,
        SETTINGS,
    )


def stop(
    target: Station, priority: RequestPriority = RequestPriority.STOP, address: int | None = None
) -> PreparedRequest:
    request = modbus.WriteRegister(target.address if address is None else address, COMMAND, STOP)
    return PreparedRequest(
        BusRequest(station=target.address, request=request, priority=priority), "token", target, SETTINGS
    )


def write(
    target: Station, register: int = SPEED, *, until: float = 100.0, priority: RequestPriority = RequestPriority.COMMAND
) -> PreparedRequest:
    effect = Effect.MOTION if register == COMMAND else Effect.SETTING
    permit = Permit(
        station=target.address,
        effect=effect,
        retry_policy=RetryPolicy.EDGE_TRIGGERED,
        expires_at=until,
        stop_epoch=target.stop_epoch,
    )
    request = modbus.WriteRegister(target.address, register, START)
    return PreparedRequest(
        BusRequest(
            station=target.address,
            request=request,
            priority=priority,
            permit=permit,
            expires_at=until,
        ),
        "token",
        target,
        SETTINGS,
    )


def poll(target: Station, period_s: float = 0.0, due: float = 0.0) -> PreparedPoll:
    return PreparedPoll(Poll(read(target.address), period_s), "polls", target, SETTINGS, due)


def filled(*requests: PreparedRequest) -> Scheduler:
    made = Scheduler(SETTINGS)
    for prepared in requests:
        made.enqueue(prepared)
    return made


def taken(scheduler: Scheduler, count: int, now: float = 0.0) -> list[PreparedRequest]:
    found = []
    for _ in range(count):
        prepared = scheduler.next(now)
        assert prepared is not None
        scheduler.on_sent(prepared, now)
        found.append(prepared)
    return found


def test_the_limits_of_the_fairness_rules_are_those_that_the_page_names() -> None:
    assert (MAX_COMMANDS_IN_ROW, MAX_POLLS_IN_ROW) == (4, 9)


def test_an_empty_queue_has_no_next_request() -> None:
    empty = Scheduler(SETTINGS)
    assert empty.next_wake_at == inf
    assert empty.next(0.0) is None and empty.next_wake_at == inf and len(empty) == 0


def test_priorities_go_in_their_order_and_each_first_come_first_served() -> None:
    first = station()
    requests = [
        make_read(first, priority)
        for priority in (
            RequestPriority.PROBE,
            RequestPriority.POLL,
            RequestPriority.PARAMETER,
            RequestPriority.STOP_READ,
            RequestPriority.COMMAND,
        )
        for _ in range(2)
    ]
    scheduler = filled(*requests)
    assert len(scheduler) == 10
    assert taken(scheduler, 4) == [*requests[8:], *requests[6:8]]
    scheduler = filled(*requests[:6])
    assert taken(scheduler, 6) == [*requests[4:6], *requests[2:4], *requests[:2]]
    assert len(scheduler) == 0


@pytest.mark.parametrize("priority", [RequestPriority.STOP_READ, RequestPriority.PARAMETER])
def test_after_four_commands_a_stop_read_or_parameter_has_its_turn(priority: RequestPriority) -> None:
    first = station()
    commands, parameters = (
        [make_read(first, RequestPriority.COMMAND) for _ in range(10)],
        [make_read(first, priority) for _ in range(2)],
    )
    assert taken(filled(*commands, *parameters), 12) == [
        *commands[:4],
        parameters[0],
        *commands[4:8],
        parameters[1],
        *commands[8:],
    ]


def test_after_two_stop_reads_a_parameter_has_its_turn() -> None:
    first = station()
    stop_reads = [make_read(first, RequestPriority.STOP_READ) for _ in range(6)]
    parameters = [make_read(first) for _ in range(3)]
    scheduler = filled(*stop_reads, *parameters)
    assert taken(scheduler, 4) == [*stop_reads[:2], parameters[0], stop_reads[2]]
    scheduler.enqueue(command := make_read(first, RequestPriority.COMMAND))
    assert taken(scheduler, 5) == [command, stop_reads[3], parameters[1], *stop_reads[4:]]


@pytest.mark.parametrize(
    ("waiting", "of_silent_stations", "turns"),
    [
        (RequestPriority.STOP_READ, RequestPriority.PARAMETER, 16),  # two of three
        (RequestPriority.PARAMETER, RequestPriority.STOP_READ, 8),  # one of three
        (RequestPriority.PARAMETER, RequestPriority.COMMAND, 4),  # one of five
        (RequestPriority.STOP_READ, RequestPriority.COMMAND, 4),
    ],
)
def test_the_sync_probes_of_silent_stations_count_as_the_requests_that_wait_for_them(
    waiting: RequestPriority, of_silent_stations: RequestPriority, turns: int
) -> None:
    """They counted as none: requests of silent stations, repeated again and again, took every turn of the others."""
    scheduler, live, silent = Scheduler(SETTINGS), station(), station(2)
    sent = []
    for _ in range(30):  # six of them a sync probe in its own turn
        for priority, asked in ((waiting, live), (of_silent_stations, silent)):
            if not scheduler.queues[priority]:
                scheduler.enqueue(make_read(asked, priority))
        scheduler.mark_suspect(silent, 0.0)
        now = silent.quarantined_until
        chosen = scheduler.next(now)
        assert chosen is not None
        scheduler.on_sent(chosen, now)
        sent.append(chosen.station)
    assert sent.count(live) == turns


def test_commands_without_a_waiting_parameter_do_not_count() -> None:
    first = station()
    commands = [make_read(first, RequestPriority.COMMAND) for _ in range(8)]
    scheduler = filled(*commands)
    taken(scheduler, 3)
    late = make_read(first)
    scheduler.enqueue(late)
    assert taken(scheduler, 5) == [*commands[3:7], late]


@pytest.mark.parametrize("priority", [RequestPriority.COMMAND, RequestPriority.STOP_READ, RequestPriority.PARAMETER])
def test_after_four_urgent_frames_a_poll_has_its_turn(priority: RequestPriority) -> None:
    first, other = station(), station(2)
    urgent, polled = [make_read(first, priority) for _ in range(10)], poll(other)
    scheduler = filled(*urgent)
    scheduler.poll_schedule.add(polled)
    assert taken(scheduler, 10) == [*urgent[:4], polled, *urgent[4:8], polled]


def test_after_four_urgent_frames_a_sync_probe_has_its_turn_only_when_due() -> None:
    first, other = station(), station(2)
    urgent = [make_read(first) for _ in range(12)]
    scheduler = filled(*urgent)
    scheduler.mark_suspect(other, 0.0)
    assert taken(scheduler, 5) == urgent[:5]
    due = other.quarantined_until
    assert scheduler.next(due) is scheduler._pending_sync_probes[other]


def test_a_stop_or_poll_between_them_breaks_a_run_of_urgent_frames() -> None:
    first = station()
    urgent = [make_read(first) for _ in range(8)]
    scheduler = filled(*urgent)
    polled = poll(station(2))
    scheduler.poll_schedule.add(polled)
    taken(scheduler, 3)
    between = stop(first)
    scheduler.enqueue(between)
    assert taken(scheduler, 6) == [between, *urgent[3:7], polled]


def test_after_nine_polls_a_probe_has_its_turn() -> None:
    first, polled = station(), poll(station(2))
    probes = [make_read(first, RequestPriority.PROBE) for _ in range(2)]
    scheduler = filled(*probes)
    scheduler.poll_schedule.add(polled)
    assert taken(scheduler, 20) == [*[polled] * 9, probes[0], *[polled] * 9, probes[1]]


def test_a_stop_goes_first_and_a_stop_of_another_priority_after_it() -> None:
    first, other = station(), station(2)
    level, real, command = stop(first, RequestPriority.COMMAND), stop(other), make_read(first, RequestPriority.COMMAND)
    scheduler = filled(command, level, real)
    assert taken(scheduler, 3) == [real, level, command]


def test_a_broadcast_stop_goes_first_then_the_drive_stopped_longest_ago() -> None:
    first, second, third = station(), station(2), station(3)
    scheduler = filled(stop(first))
    taken(scheduler, 1, 1.0)
    scheduler.enqueue(stop(second))
    taken(scheduler, 1, 2.0)
    requests = [stop(second), stop(first), stop(third), stop(first, address=0)]
    for prepared in requests:
        scheduler.enqueue(prepared)
    assert taken(scheduler, 4, 3.0) == [requests[3], requests[2], requests[1], requests[0]]


def test_a_broadcast_is_no_stations_own_stop() -> None:
    first, second = station(), station(2)
    scheduler = filled(stop(first, address=0))
    taken(scheduler, 1, 1.0)
    requests = [stop(first), stop(second)]
    for prepared in requests:
        scheduler.enqueue(prepared)
    assert taken(scheduler, 2, 2.0) == requests


def test_a_station_removed_and_registered_again_has_no_earlier_stop() -> None:
    first, second = station(), station(2)
    scheduler = filled(stop(first))
    taken(scheduler, 1, 1.0)
    scheduler.remove_station(first)
    requests = [stop(first), stop(second)]
    for prepared in requests:
        scheduler.enqueue(prepared)
    assert taken(scheduler, 2, 2.0) == requests


def test_another_attempt_is_first_in_its_priority_but_a_stop_is_last() -> None:
    first, other = station(), station(2)
    waiting, again = make_read(other), make_read(first)
    scheduler = filled(waiting)
    scheduler.requeue(again)
    assert taken(scheduler, 2) == [again, waiting]
    waiting, again = stop(other), stop(first)
    scheduler = filled(waiting)
    scheduler.requeue(again)
    assert taken(scheduler, 2) == [waiting, again]


def test_a_frame_leaves_up_to_its_last_moment_and_not_later() -> None:
    first = station()
    start = write(first, COMMAND, until=10.0)
    scheduler = filled(start)
    assert scheduler.next(10.0) is start and scheduler.rejected == []
    assert scheduler.next_wake_at == pytest.approx(10.001)
    assert scheduler.next(10.0125) is None
    ((prepared, error),) = scheduler.rejected
    assert prepared is start and isinstance(error, Expired) and len(scheduler) == 0
    assert error.key == "bus.expired" and error.params == {"station": 1, "late_ms": 12}


def test_a_frame_that_lost_its_permit_is_rejected_and_the_next_goes() -> None:
    first = station()
    start, after = write(first, COMMAND), make_read(first, RequestPriority.COMMAND)
    first.stop_epoch += 1
    scheduler = filled(start, after)
    assert scheduler.next(0.0) is after
    ((prepared, error),) = scheduler.rejected
    assert prepared is start and isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"


def test_a_frame_without_a_permit_is_rejected_although_it_is_first() -> None:
    first = station()
    bare = PreparedRequest(
        BusRequest(station=1, request=modbus.WriteRegister(1, COMMAND, START), priority=RequestPriority.COMMAND),
        "token",
        first,
        SETTINGS,
    )
    scheduler = filled(bare)
    assert scheduler.next(0.0) is None
    assert [(prepared, error.key) for prepared, error in scheduler.rejected] == [(bare, "bus.no_permit")]  # type: ignore[attr-defined]


def test_a_read_with_an_expiry_that_is_first_in_its_priority_expires_too() -> None:
    first = station()
    scheduler = filled(make_read(first, expires_at=1.0))
    assert scheduler.next(1.0) is not None and scheduler.next(1.1) is None


def test_a_suspect_stations_sync_probe_goes_in_its_frames_place_when_the_quarantine_is_over() -> None:
    first, other = station(), station(2)
    first.mark_suspect(0.0)
    mine, others = make_read(first), make_read(other)
    scheduler = filled(mine, others)
    until = first.quarantined_until
    assert scheduler.next(until - 0.001) is others
    assert scheduler.next_wake_at == until
    probe = scheduler.next(until)
    assert probe is not None and probe.is_sync_probe and probe.station is first
    scheduler.on_sent(probe, until)
    assert first not in scheduler._pending_sync_probes and len(scheduler) == 2


def test_the_sync_probe_that_has_been_due_longest_goes_first() -> None:
    first, second, third = station(), station(2), station(3)
    scheduler = Scheduler(SETTINGS)
    for at, each in ((0.3, first), (0.1, second), (0.2, third)):
        scheduler.mark_suspect(each, at)
        scheduler.mark_suspect(each, at)
    assert len(scheduler.untrusted_stations) == 3
    assert scheduler.next(0.0) is None and scheduler.next_wake_at == second.quarantined_until
    probe = scheduler.next(10.0)
    assert probe is not None and probe.station is second
    scheduler.mark_trusted(second, 10.0)
    probe = scheduler.next(10.0)
    assert probe is not None and probe.station is third
    scheduler.remove_station(third)
    probe = scheduler.next(10.0)
    assert probe is not None and probe.station is first
    scheduler.mark_trusted(first, 10.0)
    scheduler.mark_trusted(first, 10.0)
    assert scheduler.next(10.0) is None and scheduler.untrusted_stations == []


def test_a_silent_station_is_probed_when_its_pause_and_the_budget_allow_it() -> None:
    silent, suspect = station(), station(2)
    scheduler = Scheduler(SETTINGS)
    for each in (silent, suspect):
        scheduler.mark_suspect(each, 0.0)
    silent.mark_offline(0.0)
    assert silent.next_probe_at == 1.0 > suspect.quarantined_until
    probe = scheduler.next(5.0)
    assert probe is not None and probe.station is suspect, "it has been due since its quarantine, the probe later"
    scheduler.probe_budget.allowed_at = 7.0
    scheduler.mark_trusted(suspect, 5.0)
    assert scheduler.next(5.0) is None and scheduler.next_wake_at == 7.0
    probe = scheduler.next(7.0)
    assert probe is not None and probe.station is silent


def test_a_poll_is_due_at_its_time_and_not_before() -> None:
    polled = poll(station(), 0.5, due=1.0)
    scheduler = Scheduler(SETTINGS)
    scheduler.poll_schedule.add(polled)
    assert scheduler.next(0.999) is None and scheduler.next_wake_at == 1.0
    assert taken(scheduler, 1, 1.0) == [polled]
    assert scheduler.next(1.0) is None and scheduler.next_wake_at == 1.5


def test_a_polls_retry_leaves_the_queue_and_returns_the_poll_to_the_schedule() -> None:
    polled = poll(station(), 0.5)
    scheduler = Scheduler(SETTINGS)
    scheduler.poll_schedule.add(polled)
    taken(scheduler, 1)
    polled.retry_queued = True
    scheduler.requeue(polled)
    assert taken(scheduler, 1) == [polled] and not polled.retry_queued and len(scheduler) == 0
    assert taken(scheduler, 1, 0.5) == [polled]


def test_a_poll_whose_retry_waits_is_not_sent_a_second_time_when_it_falls_due() -> None:
    polled = poll(station(), 0.5, due=1.0)
    scheduler = Scheduler(SETTINGS)
    scheduler.poll_schedule.add(polled)
    polled.retry_queued = True
    assert scheduler.next(1.0) is None and scheduler.next_wake_at == 1.5


def test_a_cancelled_poll_is_never_sent() -> None:
    polled = poll(station(), 0.5, due=1.0)
    scheduler = Scheduler(SETTINGS)
    scheduler.poll_schedule.add(polled)
    polled.cancelled = True
    assert scheduler.next(1.0) is None and len(scheduler.poll_schedule.heap) == 0


def test_removed_requests_are_returned_and_a_removed_poll_is_no_retry_any_more() -> None:
    first, other = station(), station(2)
    polled = poll(first)
    polled.retry_queued = True
    mine, others = make_read(first), make_read(other)
    scheduler = filled(mine, polled, others)
    assert scheduler.remove_if(lambda prepared: prepared.station is first) == [mine, polled]
    assert not polled.retry_queued and len(scheduler) == 1


def test_a_stop_ends_its_stations_commands_and_permits_and_no_others() -> None:
    """A motion frame is removed at any priority; a read or setting outside the command priority stays."""
    first, other = station(), station(2)
    removed = [
        write(first),
        write(first, COMMAND),
        make_read(first, RequestPriority.COMMAND),
        write(first, COMMAND, priority=RequestPriority.PARAMETER),
    ]
    remaining = [
        make_read(first),
        write(first, priority=RequestPriority.PARAMETER),
        make_read(first, RequestPriority.PROBE),
        write(other),
        stop(first),
    ]
    scheduler = filled(*removed, *remaining)
    assert set(scheduler.supersede([first])) == set(removed)
    assert len(scheduler) == len(remaining)
    assert (first.stop_epoch, other.stop_epoch) == (1, 0)
    scheduler.supersede([first, first, other])
    assert (first.stop_epoch, other.stop_epoch) == (2, 1)


def test_the_polls_of_a_removed_station_end_suspended_ones_too() -> None:
    first, other = station(), station(2)
    scheduler = Scheduler(SETTINGS)
    suspended, polled, others = poll(first), poll(first), poll(other)
    scheduler.poll_schedule.suspended[first] = [suspended]
    for each in (polled, others):
        scheduler.poll_schedule.add(each)
    scheduler.remove_station(first)
    assert not scheduler.poll_schedule.suspended and polled.cancelled and not others.cancelled
    assert taken(scheduler, 2) == [others, others]


def test_a_station_that_is_trusted_again_has_its_suspended_polls_at_once() -> None:
    first = station()
    scheduler = Scheduler(SETTINGS)
    suspended = poll(first, 5.0, due=3.0)
    scheduler.poll_schedule.suspended[first] = [suspended]
    scheduler.mark_trusted(first, 10.0)
    assert not scheduler.poll_schedule.suspended and taken(scheduler, 1, 10.0) == [suspended]


def test_only_stops_count_for_whose_stop_is_next() -> None:
    """Other frames to a station do not delay its stop behind that of another."""
    first, second = station(1), station(2)
    scheduler = filled(stop(first))
    taken(scheduler, 1, 1.0)
    scheduler.enqueue(make_read(second))
    taken(scheduler, 1, 2.0)
    for each in (stop(first), stop(second)):
        scheduler.enqueue(each)
    assert [prepared.station for prepared in taken(scheduler, 2, 3.0)] == [second, first]


def test_only_commands_bring_a_waiting_parameter_its_turn() -> None:
    first = station()
    scheduler = filled(make_read(first), *(stop(first) for _ in range(MAX_COMMANDS_IN_ROW)))
    taken(scheduler, MAX_COMMANDS_IN_ROW)
    scheduler.enqueue(write(first))
    assert [prepared.priority for prepared in taken(scheduler, 2)] == [
        RequestPriority.COMMAND,
        RequestPriority.PARAMETER,
    ]


def test_lateness_is_reported_in_milliseconds() -> None:
    scheduler = filled(write(station(), until=1.0))
    assert scheduler.next(3.0) is None
    [(_, error)] = scheduler.rejected
    assert isinstance(error, Expired) and error.params["late_ms"] == 2000


def test_the_polls_of_a_bus_begin_at_different_times_within_their_period() -> None:
    """A hundred polls that are due together would keep the last of them waiting for the other frames, every time."""
    schedule = PollSchedule()
    phases = [schedule.next_phase_s(Poll(read(), 10.0)) for _ in range(4)]
    assert phases == pytest.approx([0.0, 6.18034, 2.36068, 8.54102], abs=1e-4)
    assert schedule.next_phase_s(Poll(read(), 10.0, phase_s=3.0)) == 3.0
    assert schedule.next_phase_s(Poll(read(), 1.0)) == pytest.approx(0.47214, abs=1e-4)


def scheduled(*due: float) -> tuple[PollSchedule, list[PreparedPoll]]:
    """Return a schedule of polls with these due times, and the polls in the same order."""
    target, schedule = station(), PollSchedule()
    polls = [poll(target, 60.0, at) for at in due]
    for each in polls:
        schedule.add(each)
    return schedule, polls


def test_a_poll_that_is_made_due_goes_before_polls_that_are_due_later() -> None:
    schedule, polls = scheduled(5.0, 6.0, 7.0)
    schedule.make_due(lambda each: each is polls[2], 1.0)
    assert schedule.next_due(1.0) is polls[2]
    schedule.mark_sent(polls[2], 1.0)
    assert schedule.next_due(4.9) is None and schedule.next_due(5.0) is polls[0]


@pytest.mark.parametrize("due", [0.5, 1.0])
def test_an_overdue_poll_that_is_made_due_keeps_its_times(due: float) -> None:
    """It is sent next anyway; with a later due time, polls that became due after it would go first."""
    schedule, (overdue,) = scheduled(due)
    overdue.phase_at = 0.25
    schedule.make_due(lambda _: True, 1.0)
    assert (overdue.due_at, overdue.phase_at, schedule.next_due_at()) == (due, 0.25, due)


def test_the_most_overdue_poll_goes_first_after_others_were_cancelled() -> None:
    schedule, polls = scheduled(1.0, 5.0, 2.0, 6.0, 7.0, 3.0)
    schedule.cancel_if(lambda each: each in (polls[0], polls[2]))
    assert schedule.next_due_at() == 3.0 and schedule.next_due(3.0) is polls[5]
    assert all(each.cancelled is (each in (polls[0], polls[2])) for each in polls)


def test_a_station_registered_again_gets_a_new_sync_probe() -> None:
    """The waiting probe of the removed one may be of another model."""
    target, scheduler = station(), Scheduler(SETTINGS)
    scheduler.mark_suspect(target, 0.0)
    waiting = scheduler.next(10.0)
    assert waiting is not None and scheduler.next(10.0) is waiting
    scheduler.remove_station(target)
    scheduler.mark_suspect(target, 0.0)
    fresh = scheduler.next(10.0)
    assert fresh is not None and fresh.is_sync_probe and fresh is not waiting
