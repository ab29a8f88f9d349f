"""Requests and polls that a caller withdraws: only its own end, and what is on the wire is not repeated."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivebus.bus import Poll
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.errors import Expired, Superseded
from fixtures.bus import (
    DAMAGED_REPLY,
    FakeStation,
    make_script,
    make_traced_script,
    read,
    read_request,
    stop_request,
    write_request,
)


def test_cancelling_a_queued_request_leaves_those_of_others_queued() -> None:
    script = make_script(FakeStation())
    for token in ("on the wire", "cancelled", "other"):
        script.submit(read_request(), token)
    script._perform(script.core.cancel("cancelled", script.now))
    script.run()
    assert script.results["other"][-1].error is None and "cancelled" not in script.results
    assert len(script.sent) == 2


def test_cancelling_a_queued_request_does_not_take_the_retries_of_the_one_on_the_wire() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(), "on the wire")
    script.submit(read_request(register=0x3100), "cancelled")
    script._perform(script.core.cancel("cancelled", script.now))
    script.run_until(script.now + 0.1)
    station.alive = True
    assert script.result("on the wire").attempts == 2


def test_a_cancelled_stop_is_still_sent() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "on the wire")
    script.run_until(0.01)
    script.submit(stop_request(), "stop")
    script._perform(script.core.cancel("stop", script.now))
    assert script.result("stop").error is None


def test_cancelled_polls_are_not_repeated_after_a_damaged_reply() -> None:
    """The damaged reply has come, so its repetition waits only for the gap; the subscription ends meanwhile."""
    script = make_script(FakeStation())
    script.submit(read_request(), "first")
    script.result("first")
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, DAMAGED_REPLY)]
    script.start_polling(1, [Poll(read(), 60.0, phase_s=0.0)])
    while script.core.transaction is None or not script.core.transaction.buffer:
        script._step(script._next_at())
    count = len(script.sent)
    script._perform(script.core.stop_polling("polls", script.now))
    script.run_until(script.now + 30)
    assert len(script.sent) == count and "polls" not in script.results


def test_a_cancelled_poll_whose_repetition_waits_for_a_sync_probe_is_not_repeated() -> None:
    station = FakeStation()
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 0.1, phase_s=0.0)])
    script.run_until(0.25)
    station.alive = False
    script.run_until(0.55)
    assert script.core.stations[1].state.is_suspect and len(script.core.scheduler) == 1
    script._perform(script.core.stop_polling("polls", script.now))
    count, station.alive = station.read_count, True
    script.run_until(10)
    assert station.read_count == count


def test_only_the_polls_of_their_own_subscription_are_made_due() -> None:
    script = make_script(FakeStation())
    for token in ("made due", "other"):
        script.start_polling(1, [Poll(read(), 10.0, phase_s=5.0)], token)
    script.make_polls_due([read()], "made due")
    script.run_until(1.0)
    assert len(script.results["made due"]) == 1 and "other" not in script.results


def test_a_command_that_a_stop_overtakes_names_the_stop_as_its_reason() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "on the wire")
    script.submit(write_request(script.core), "command")
    script.submit(stop_request(), "stop")
    error = script.result("command").error
    assert isinstance(error, Superseded) and error.key == "bus.superseded"


def test_requests_that_expire_in_the_queue_fail_in_the_order_of_their_submission() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "on the wire")
    script.run_until(0.01)
    for token in ("first", "second"):
        script.submit(write_request(script.core, until=0.011), token)
    script.run()
    assert [*script.results] == ["on the wire", "first", "second"]
    assert all(isinstance(script.results[token][-1].error, Expired) for token in ("first", "second"))


def test_the_queued_command_of_a_station_is_withdrawn_with_its_reason_and_the_read_stays() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "on the wire")
    script.submit(write_request(script.core), "command")
    script.submit(read_request(), "read")
    script._perform(script.core.withdraw_commands(1, Superseded("bus.superseded", station=1), script.now))
    script.run()
    assert isinstance(script.results["command"][-1].error, Superseded)
    assert script.results["read"][-1].error is None and len(script.sent) == 2


@pytest.mark.parametrize(
    ("request_of", "withdrawn_station", "attempts"),
    [(write_request, 1, 1), (write_request, 2, 2), (lambda core: read_request(), 1, 2)],
)
def test_only_a_withdrawn_command_on_the_wire_gets_no_further_attempt(
    request_of: Callable[[BusCore], BusRequest], withdrawn_station: int, attempts: int
) -> None:
    """A read, and a command of another station, are sent once more after the missing reply."""
    station = FakeStation()
    script = make_traced_script(station, FakeStation(address=2))
    station.alive = False
    script.submit(request_of(script.core), "on the wire")
    script.run_until(script.now + 0.01)
    why = Superseded("bus.superseded", station=withdrawn_station)
    script._perform(script.core.withdraw_commands(withdrawn_station, why, script.now))
    script.run_until(script.now + 0.1)
    station.alive = True
    assert script.result("on the wire").attempts == attempts
