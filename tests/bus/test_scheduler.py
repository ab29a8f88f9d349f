"""Whose frame is next: the scheduler alone, one decision at a time (G07, G08, I1, I3, I4, ruling 12)."""

from __future__ import annotations

from typing import Any

import pytest

from buskit import COMMAND, LINE, START, STOP, link, read
from drivebus.bus.job import Job
from drivebus.bus.planner import Poll, PollJob
from drivebus.bus.scheduler import FOREVER, POLL_RUN, URGENT_RUN, Scheduler
from drivebus.bus.stations import Station
from drivebus.errors import Expired, NotPermitted
from drivebus.message import Ask, Effect, Lane, Permit, WriteClass
from drivebus.protocols import modbus

SPEED = 0x2001


def station(address: int = 1) -> Station:
    return Station(link(address), LINE)


def ask(one: Station, lane: Lane = Lane.PARAMETER, **more: Any) -> Job:
    return Job(Ask(one.address, read(one.address), lane, **more), "token", one, LINE)


def stop(one: Station, lane: Lane = Lane.STOP, address: int | None = None) -> Job:
    request = modbus.WriteRegister(one.address if address is None else address, COMMAND, STOP)
    return Job(Ask(one.address, request, lane), "token", one, LINE)


def write(one: Station, register: int = SPEED, *, until: float = 100.0, lane: Lane = Lane.COMMAND) -> Job:
    effect = Effect.MOTION if register == COMMAND else Effect.SETTING
    permit = Permit(one.address, effect, WriteClass.EDGE, until, one.generation)
    request = modbus.WriteRegister(one.address, register, START)
    return Job(Ask(one.address, request, lane, WriteClass.EDGE, permit, until), "token", one, LINE)


def poll(one: Station, period_s: float = 0.0, due: float = 0.0) -> PollJob:
    return PollJob(Poll(read(one.address), period_s), "watch", one, LINE, due)


def filled(*jobs: Job) -> Scheduler:
    made = Scheduler(LINE)
    for job in jobs:
        made.put(job)
    return made


def taken(scheduler: Scheduler, count: int, now: float = 0.0) -> list[Job]:
    found = []
    for _ in range(count):
        job = scheduler.next(now)
        assert job is not None
        scheduler.took(job, now)
        found.append(job)
    return found


def test_the_limits_of_the_fairness_rules_are_those_that_the_page_names() -> None:
    assert (URGENT_RUN, POLL_RUN) == (4, 9)


def test_nothing_is_next_where_nothing_waits() -> None:
    empty = Scheduler(LINE)
    assert empty.wake_at == FOREVER
    assert empty.next(0.0) is None and empty.wake_at == FOREVER and len(empty) == 0


def test_lanes_go_in_their_order_and_each_first_come_first_served() -> None:
    one = station()
    jobs = [ask(one, lane) for lane in (Lane.PROBE, Lane.POLL, Lane.PARAMETER, Lane.COMMAND) for _ in range(2)]
    scheduler = filled(*jobs)
    assert len(scheduler) == 8
    assert taken(scheduler, 4) == [*jobs[6:], *jobs[4:6]]
    assert taken(scheduler, 4) == [*jobs[2:4], *jobs[:2]]
    assert len(scheduler) == 0


def test_g07_after_four_commands_a_parameter_has_its_turn() -> None:
    one = station()
    commands, parameters = [ask(one, Lane.COMMAND) for _ in range(10)], [ask(one) for _ in range(2)]
    assert taken(filled(*commands, *parameters), 12) == [
        *commands[:4], parameters[0], *commands[4:8], parameters[1], *commands[8:],
    ]  # fmt: skip


def test_commands_that_nobody_waited_behind_do_not_count() -> None:
    one = station()
    commands = [ask(one, Lane.COMMAND) for _ in range(8)]
    scheduler = filled(*commands)
    taken(scheduler, 3)
    late = ask(one)
    scheduler.put(late)
    assert taken(scheduler, 5) == [*commands[3:7], late]


@pytest.mark.parametrize("lane", [Lane.COMMAND, Lane.PARAMETER])
def test_i4_after_four_urgent_frames_a_poll_has_its_turn(lane: Lane) -> None:
    one, other = station(), station(2)
    urgent, polled = [ask(one, lane) for _ in range(10)], poll(other)
    scheduler = filled(*urgent)
    scheduler.plan.put(polled)
    assert taken(scheduler, 10) == [*urgent[:4], polled, *urgent[4:8], polled]


def test_i4_after_four_urgent_frames_a_due_fence_has_its_turn_and_one_not_due_has_none() -> None:
    one, other = station(), station(2)
    urgent = [ask(one) for _ in range(12)]
    scheduler = filled(*urgent)
    other.doubt(0.0)
    scheduler.doubts(other)
    assert taken(scheduler, 5) == urgent[:5]
    due = other.quarantined_until
    assert scheduler.next(due) is other.fence_waiting


def test_a_stop_or_poll_between_them_breaks_a_run_of_urgent_frames() -> None:
    one = station()
    urgent = [ask(one) for _ in range(8)]
    scheduler = filled(*urgent)
    polled = poll(station(2))
    scheduler.plan.put(polled)
    taken(scheduler, 3)
    between = stop(one)
    scheduler.put(between)
    assert taken(scheduler, 6) == [between, *urgent[3:7], polled]


def test_after_nine_polls_a_probe_has_its_turn() -> None:
    one, polled = station(), poll(station(2))
    probes = [ask(one, Lane.PROBE) for _ in range(2)]
    scheduler = filled(*probes)
    scheduler.plan.put(polled)
    assert taken(scheduler, 20) == [*[polled] * 9, probes[0], *[polled] * 9, probes[1]]


def test_i3_a_stop_goes_before_everything_and_one_asked_for_in_another_lane_after_the_others() -> None:
    one, other = station(), station(2)
    level, real, command = stop(one, Lane.COMMAND), stop(other), ask(one, Lane.COMMAND)
    scheduler = filled(command, level, real)
    assert taken(scheduler, 3) == [real, level, command]


def test_g06_a_broadcast_stop_goes_first_then_whoever_was_stopped_longest_ago() -> None:
    one, two, three = station(), station(2), station(3)
    scheduler = filled(stop(one))
    taken(scheduler, 1, 1.0)
    scheduler.put(stop(two))
    taken(scheduler, 1, 2.0)
    jobs = [stop(two), stop(one), stop(three), stop(one, address=0)]
    for job in jobs:
        scheduler.put(job)
    assert taken(scheduler, 4, 3.0) == [jobs[3], jobs[2], jobs[1], jobs[0]]


def test_a_broadcast_is_no_stations_own_stop() -> None:
    one, two = station(), station(2)
    scheduler = filled(stop(one, address=0))
    taken(scheduler, 1, 1.0)
    jobs = [stop(one), stop(two)]
    for job in jobs:
        scheduler.put(job)
    assert taken(scheduler, 2, 2.0) == jobs


def test_a_station_taken_away_and_put_back_has_no_stop_behind_it() -> None:
    one, two = station(), station(2)
    scheduler = filled(stop(one))
    taken(scheduler, 1, 1.0)
    scheduler.forget(one)
    jobs = [stop(one), stop(two)]
    for job in jobs:
        scheduler.put(job)
    assert taken(scheduler, 2, 2.0) == jobs


def test_another_attempt_is_first_in_its_lane_but_a_stop_is_last() -> None:
    one, other = station(), station(2)
    waiting, again = ask(other), ask(one)
    scheduler = filled(waiting)
    scheduler.again(again)
    assert taken(scheduler, 2) == [again, waiting]
    waiting, again = stop(other), stop(one)
    scheduler = filled(waiting)
    scheduler.again(again)
    assert taken(scheduler, 2) == [waiting, again]


def test_ruling_12_a_frame_leaves_up_to_its_last_moment_and_not_later() -> None:
    one = station()
    start = write(one, COMMAND, until=10.0)
    scheduler = filled(start)
    assert scheduler.next(10.0) is start and scheduler.refused == []
    assert scheduler.wake_at == pytest.approx(10.001)
    assert scheduler.next(10.0125) is None
    ((job, error),) = scheduler.refused
    assert job is start and isinstance(error, Expired) and len(scheduler) == 0
    assert error.key == "bus.expired" and error.params == {"station": 1, "late_ms": 12}


def test_i1_a_frame_that_lost_its_permit_is_refused_and_the_next_goes() -> None:
    one = station()
    start, after = write(one, COMMAND), ask(one, Lane.COMMAND)
    one.generation += 1
    scheduler = filled(start, after)
    assert scheduler.next(0.0) is after
    ((job, error),) = scheduler.refused
    assert job is start and isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"


def test_i1_a_frame_without_a_permit_is_refused_although_it_is_first() -> None:
    one = station()
    bare = Job(Ask(1, modbus.WriteRegister(1, COMMAND, START), Lane.COMMAND), "token", one, LINE)
    scheduler = filled(bare)
    assert scheduler.next(0.0) is None
    assert [(job, error.key) for job, error in scheduler.refused] == [(bare, "bus.no_permit")]  # type: ignore[attr-defined]


def test_a_read_with_an_expiry_that_is_first_in_its_lane_expires_too() -> None:
    one = station()
    scheduler = filled(ask(one, expires_at=1.0))
    assert scheduler.next(1.0) is not None and scheduler.next(1.1) is None


def test_a_suspect_stations_fence_goes_in_its_frames_place_when_the_quarantine_is_over() -> None:
    one, other = station(), station(2)
    one.doubt(0.0)
    mine, others = ask(one), ask(other)
    scheduler = filled(mine, others)
    until = one.quarantined_until
    assert scheduler.next(until - 0.001) is others
    assert scheduler.wake_at == until
    fence = scheduler.next(until)
    assert fence is not None and fence.fence and fence.station is one
    scheduler.took(fence, until)
    assert one.fence_waiting is None and len(scheduler) == 2


def test_the_fence_that_has_been_due_longest_goes_first() -> None:
    one, two, three = station(), station(2), station(3)
    scheduler = Scheduler(LINE)
    for at, each in ((0.3, one), (0.1, two), (0.2, three)):
        each.doubt(at)
        scheduler.doubts(each)
        scheduler.doubts(each)
    assert len(scheduler.doubted) == 3
    assert scheduler.next(0.0) is None and scheduler.wake_at == two.quarantined_until
    fence = scheduler.next(10.0)
    assert fence is not None and fence.station is two
    scheduler.trusts(two, 10.0)
    fence = scheduler.next(10.0)
    assert fence is not None and fence.station is three
    scheduler.forget(three)
    fence = scheduler.next(10.0)
    assert fence is not None and fence.station is one
    scheduler.trusts(one, 10.0)
    scheduler.trusts(one, 10.0)
    assert scheduler.next(10.0) is None and scheduler.doubted == []


def test_g08_a_silent_station_is_probed_when_its_pause_and_the_budget_allow_it() -> None:
    silent, suspect = station(), station(2)
    scheduler = Scheduler(LINE)
    for each in (silent, suspect):
        each.doubt(0.0)
        scheduler.doubts(each)
    silent.give_up(0.0)
    assert silent.probe_at == 1.0 > suspect.quarantined_until
    fence = scheduler.next(5.0)
    assert fence is not None and fence.station is suspect, "it has been due since its quarantine, the probe later"
    scheduler.budget.allowed_at = 7.0
    scheduler.trusts(suspect, 5.0)
    assert scheduler.next(5.0) is None and scheduler.wake_at == 7.0
    fence = scheduler.next(7.0)
    assert fence is not None and fence.station is silent


def test_a_poll_is_due_at_its_time_and_not_before() -> None:
    polled = poll(station(), 0.5, due=1.0)
    scheduler = Scheduler(LINE)
    scheduler.plan.put(polled)
    assert scheduler.next(0.999) is None and scheduler.wake_at == 1.0
    assert taken(scheduler, 1, 1.0) == [polled]
    assert scheduler.next(1.0) is None and scheduler.wake_at == 1.5


def test_a_polls_second_attempt_goes_from_the_queue_and_gives_the_poll_back_to_the_plan() -> None:
    polled = poll(station(), 0.5)
    scheduler = Scheduler(LINE)
    scheduler.plan.put(polled)
    taken(scheduler, 1)
    polled.retrying = True
    scheduler.again(polled)
    assert taken(scheduler, 1) == [polled] and not polled.retrying and len(scheduler) == 0
    assert taken(scheduler, 1, 0.5) == [polled]


def test_what_is_withdrawn_is_gone_and_told_and_a_poll_of_it_is_no_second_attempt_any_more() -> None:
    one, other = station(), station(2)
    polled = poll(one)
    polled.retrying = True
    mine, others = ask(one), ask(other)
    scheduler = filled(mine, polled, others)
    assert scheduler.withdraw(lambda job: job.station is one) == [mine, polled]
    assert not polled.retrying and len(scheduler) == 1


def test_a_stop_ends_its_stations_commands_and_permits_and_nobody_elses() -> None:
    """6.5. A motion frame ends in whatever lane it waits; a read or setting outside the command lane stays."""
    one, other = station(), station(2)
    gone = [write(one), write(one, COMMAND), ask(one, Lane.COMMAND), write(one, COMMAND, lane=Lane.PARAMETER)]
    kept = [ask(one), write(one, lane=Lane.PARAMETER), ask(one, Lane.PROBE), write(other), stop(one)]
    scheduler = filled(*gone, *kept)
    assert set(scheduler.supersede([one])) == set(gone)
    assert len(scheduler) == len(kept)
    assert (one.generation, other.generation) == (1, 0)
    scheduler.supersede([one, one, other])
    assert (one.generation, other.generation) == (2, 1)


def test_a_forgotten_stations_polls_end_those_parked_too() -> None:
    one, other = station(), station(2)
    scheduler = Scheduler(LINE)
    parked, polled, others = poll(one), poll(one), poll(other)
    one.parked.append(parked)
    for each in (polled, others):
        scheduler.plan.put(each)
    scheduler.forget(one)
    assert one.parked == [] and polled.cancelled and not others.cancelled
    assert taken(scheduler, 2) == [others, others]


def test_a_station_that_is_trusted_again_has_its_parked_polls_at_once() -> None:
    one = station()
    scheduler = Scheduler(LINE)
    parked = poll(one, 5.0, due=3.0)
    one.parked.append(parked)
    scheduler.trusts(one, 10.0)
    assert one.parked == [] and taken(scheduler, 1, 10.0) == [parked]


def test_only_stops_count_for_whose_stop_is_next() -> None:
    """What else was said to a station meanwhile does not put its stop behind another one's."""
    one, two = station(1), station(2)
    scheduler = filled(stop(one))
    taken(scheduler, 1, 1.0)
    scheduler.put(ask(two))
    taken(scheduler, 1, 2.0)
    for each in (stop(one), stop(two)):
        scheduler.put(each)
    assert [job.station for job in taken(scheduler, 2, 3.0)] == [two, one]


def test_only_commands_bring_a_waiting_parameter_its_turn() -> None:
    one = station()
    scheduler = filled(ask(one), *(stop(one) for _ in range(URGENT_RUN)))
    taken(scheduler, URGENT_RUN)
    scheduler.put(write(one))
    assert [job.lane for job in taken(scheduler, 2)] == [Lane.COMMAND, Lane.PARAMETER]


def test_lateness_is_told_in_milliseconds() -> None:
    scheduler = filled(write(station(), until=1.0))
    assert scheduler.next(3.0) is None
    [(_, error)] = scheduler.refused
    assert isinstance(error, Expired) and error.params["late_ms"] == 2000
