"""Polls: periods, phases, lateness; and the load estimate before they are started."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf

import pytest

from drivebus import profiles
from drivebus.bus import BusStatistics, Poll, StationStatistics, estimate_bus_load
from drivebus.bus.messages import RequestPriority, StationConfig
from drivebus.bus.scheduler import PollSchedule
from drivebus.bus.statistics import percentiles
from drivebus.drives import create_dialect
from drivebus.errors import PortLost
from drivebus.protocols import modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings, StationTiming
from fixtures.bus import (
    CHARACTER_S,
    SETTINGS,
    FakeStation,
    make_script,
    read,
    read_request,
    station_config,
    write_request,
)


def test_a_poll_keeps_its_period_exactly() -> None:
    script = make_script(FakeStation())
    script.start_polling(1, [Poll(read(), 0.25, phase_s=0.1)])
    script.run_until(5)
    times = [at for at, _ in script.sent]
    assert times == pytest.approx([0.1 + 0.25 * number for number in range(20)])


def test_a_poll_that_is_made_due_is_sent_once_at_once_and_a_period_after_that() -> None:
    """Another poll of the same subscription keeps its times."""
    script = make_script(FakeStation())
    slow, other = read(), read(register=0x4000)
    script.start_polling(1, [Poll(slow, 60.0, phase_s=0.5), Poll(other, 60.0, phase_s=1.0)])
    script.run_until(10)
    script.make_polls_due({slow})
    script.run_until(75)
    assert [at for at, _ in script.sent] == pytest.approx([0.5, 1.0, 10.0, 61.0, 70.0])


def test_the_polls_of_several_stations_are_not_sent_in_one_burst() -> None:
    stations = [FakeStation(address=address) for address in range(1, 11)]
    script = make_script(*stations)
    for station in stations:
        script.start_polling(station.address, [Poll(read(station.address), 1.0)], station.address)
    script.run_until(0.99)
    times = [at for at, _ in script.sent]
    assert len(times) == 10
    assert min(later - earlier for earlier, later in pairwise(times)) > 0.03


def test_late_polls_do_not_pile_up() -> None:
    """A poll that could not be sent for ten periods is sent once, then in phase again."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.start_polling(1, [Poll(read(), 0.1, phase_s=0.0)])
    script.run_until(1.0)
    for place in range(400):
        script.receive(b"\x55", at=1.0 + place * 0.0025)
    script.run_until(2.505)
    assert len([at for at, _ in script.sent if 1.0 < at < 2.09]) <= 4
    assert [at for at, _ in script.sent if at > 2.09] == pytest.approx([2.1, 2.2, 2.3, 2.4, 2.5])


def test_the_most_overdue_goes_first() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.start_polling(1, [Poll(read(1), 1.0, phase_s=0.010)], 1)
    script.start_polling(2, [Poll(read(2), 1.0, phase_s=0.005)], 2)
    script.submit(read_request(1), "busy")
    script.run_until(0.2)
    assert [frame[0] for frame in script.frames] == [1, 2, 1]


def test_polls_that_are_due_together_keep_their_order() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    for address in (1, 2):
        script.start_polling(address, [Poll(read(address), 0.5, phase_s=0.0)], address)
    script.run_until(2.9)
    assert [frame[0] for frame in script.frames] == [1, 2] * 6


def test_a_flood_of_parameters_does_not_starve_the_polls() -> None:
    """The values stay current during a parameter backup."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.start_polling(1, [Poll(read(1), 0.1)])
    for number in range(500):
        script.submit(read_request(2), number)
    script.run_until(10)
    received = [result.received_at or 0 for result in script.results["polls"]]
    assert max(later - earlier for earlier, later in pairwise(received)) < 0.3


def test_a_flood_of_commands_does_not_starve_the_parameters() -> None:
    """The read that confirms a stop has parameter priority."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    for number in range(200):
        script.submit(read_request(2, priority=RequestPriority.COMMAND), f"command {number}")
    script.submit(read_request(1), "parameter")
    script.submit(read_request(1), "another")
    script.run()
    order = list(script.results)
    assert order.index("parameter") <= 5 and order.index("another") <= 10
    assert len(order) == 202


def test_priorities_are_served_in_their_order() -> None:
    script = make_script(FakeStation(address=1))
    script.submit(read_request(), "busy")
    script.submit(read_request(register=4, priority=RequestPriority.PROBE), "probe")
    script.submit(read_request(register=3, priority=RequestPriority.POLL), "poll")
    script.submit(read_request(register=2, priority=RequestPriority.PARAMETER), "parameter")
    script.submit(write_request(script.core, register=1), "command")
    script.run()
    assert list(script.results) == ["command", "busy", "parameter", "poll", "probe"]


def test_a_scan_gets_its_turns_on_a_full_bus() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.start_polling(1, [Poll(read(1), 0.0)])
    for number in range(20):
        script.submit(read_request(2, priority=RequestPriority.PROBE), number)
    script.run_until(20)
    assert all(number in script.results for number in range(20))


def test_a_cancelled_subscription_is_silent_even_with_its_frame_out() -> None:
    script = make_script(FakeStation())
    script.start_polling(1, [Poll(read(), 0.1, phase_s=0.0)])
    script.run_until(0.01)
    assert len(script.sent) == 1
    script._perform(script.core.stop_polling("polls", script.now))
    script.run_until(5)
    assert "polls" not in script.results and len(script.sent) == 1
    assert len(script.core.scheduler.poll_schedule.heap) == 0


def test_a_removed_stations_polls_and_requests_end() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.start_polling(1, [Poll(read(), 0.1)])
    script.submit(read_request(2), "busy")
    script.submit(read_request(1), "waiting")
    script._perform(script.core.remove_station(1, script.now))
    assert script.results["waiting"][0].error.key == "bus.removed"
    assert script.result("busy").error is None
    script.run_until(5)
    assert [frame[0] for frame in script.frames] == [2]


def test_a_period_must_be_a_time() -> None:
    for period in (-1.0, float("nan")):
        with pytest.raises(ValueError, match="period"):
            Poll(read(), period)


def test_an_empty_poll_schedule_has_nothing_due() -> None:
    assert PollSchedule().next_due_at() == inf and PollSchedule().next_due(1.0) is None


def test_the_stop_bound_is_that_of_the_documented_table() -> None:
    """C320 ASCII 8E1 with a silent drive: 607, 313, 167, 93, 57 ms, of which the host takes 20 ms."""
    timing = StationTiming(gap_characters=5, reply_delay_s=0, reply_delay_characters=8, adapter_latency_s=0.0)
    codec = sunfar.SunfarCodec()
    stop = sunfar.SunfarControl(1, sunfar.SunfarOperation.STOP)
    longest = sunfar.SunfarWriteParameter(1, 0, 1, 1)
    config = StationConfig(
        address=1,
        codec=codec,
        timing=timing,
        effect_of=lambda f: Effect.NONE,
        sync_request=lambda n: sunfar.ReadIdentity(1, 0),
        stop_request=stop,
    )
    assert len(codec.encode_request(longest)) == 18
    for baud, bound_ms in ((1200, 607), (2400, 313), (4800, 167), (9600, 93), (19200, 57)):
        found = (
            estimate_bus_load([(config, [Poll(longest, 1.0)])], SerialSettings(baud, parity="E")).drives[1].stop_bound_s
        )
        stop_ms = SerialSettings(baud, parity="E").seconds(len(codec.encode_request(stop))) * 1000
        printed_stop = {1200: 138, 2400: 69, 4800: 34, 9600: 17, 19200: 9}[baud]
        assert found * 1000 - stop_ms + printed_stop + 20 == pytest.approx(bound_ms, abs=2)


def test_the_computed_load_is_the_measured_load() -> None:
    """With stations that reply at their limit, cycle and load are the computed ones."""
    limit = 0.02 - 1e-4
    stations = [FakeStation(address=address, delay_s=limit) for address in range(1, 5)]
    script = make_script(*stations)
    polls = [Poll(read(address), 0.0) for address in range(1, 5)]
    plan = [(station_config(address), [poll]) for address, poll in zip(range(1, 5), polls, strict=True)]
    for config, station_polls in plan:
        script.start_polling(config.address, station_polls, config.address)
    script.run_until(20)
    cycle = 20 / stations[0].read_count
    load = estimate_bus_load(plan, SETTINGS)
    adapter = 4 * 0.02
    assert cycle == pytest.approx(load.cycle_s - adapter, rel=0.02)
    statistics = script.core.statistics(script.now)
    assert statistics.load_percent == pytest.approx(100 * 4 * 21 * CHARACTER_S / cycle, rel=0.01)


def test_statistics_have_rates_times_and_errors_of_bus_and_drive() -> None:
    stations = [FakeStation(address=1, delay_s=0.004), FakeStation(address=2, delay_s=0.008)]
    script = make_script(*stations)
    for station in stations:
        script.start_polling(station.address, [Poll(read(station.address), 0.1)], station.address)
    script.run_until(30)
    stations[1].alive = False
    script.run_until(31)
    found = script.core.statistics(script.now)
    assert found.transactions_per_s == pytest.approx(20, rel=0.05)
    assert found.stations[1].reply_p50_s == pytest.approx(0.004 + 13 * CHARACTER_S)
    assert found.stations[2].reply_p99_s == pytest.approx(0.008 + 13 * CHARACTER_S)
    assert found.reply_p99_s == pytest.approx(0.008 + 13 * CHARACTER_S)
    assert found.errors["NoReply"] == found.stations[2].errors["NoReply"] >= 2
    assert found.stations[1].errors == {}
    assert found.bytes_sent == 8 * found.transactions
    assert found.bytes_received == 13 * found.replies
    assert found.elapsed_s == 31
    assert 0 < found.load_percent < found.occupied_percent <= 100


def test_percentiles_are_by_nearest_rank() -> None:
    assert percentiles([1.0]) == (1.0, 1.0, 1.0)
    assert percentiles([1.0, 2.0]) == (1.0, 2.0, 2.0)
    assert percentiles([float(n) for n in range(1, 101)]) == (50.0, 95.0, 99.0)
    assert percentiles([]) == (None, None, None)


def test_totals_and_their_time_go_on_through_a_replug_and_recent_shares_begin_again() -> None:
    script = make_script(FakeStation())
    script.start_polling(1, [Poll(read(), 0.1, phase_s=0.05)])
    script.run_until(30)
    script.lose_port(PortLost("ports.lost"))
    script.run_until(50)
    script.reopen()
    script.run_until(60)
    found = script.core.statistics(script.now)
    assert found.elapsed_s == 60 and found.transactions == pytest.approx(400, abs=3)
    assert found.transactions_per_s == pytest.approx(10, rel=0.02)


def test_each_line_error_is_counted_once_for_the_bus_and_for_the_addressed_drive() -> None:
    script = make_script(FakeStation(alive=False))
    script.receive(b"\x00", line_errors=1)
    script.run_until(0.5)
    script.submit(read_request())
    for at in (0.52, 0.53):
        script.receive(b"\x01\x03", at=at, line_errors=2)
    script.run_until(0.54)
    found = script.core.statistics(script.now)
    assert (found.counters["line_errors"], found.stations[1].counters["line_errors"]) == (5, 4)
    script.run_until(2)
    assert script.core.statistics(script.now).counters["line_errors"] == 5


def test_each_drive_has_its_own_load_and_rate_and_together_they_are_the_bus() -> None:
    """In 30 s the first drive has 300 transactions, the second 30, the third none."""
    script = make_script(
        FakeStation(address=1, delay_s=0.004), FakeStation(address=2, delay_s=0.008), FakeStation(address=3)
    )
    script.start_polling(1, [Poll(read(1), 0.1, phase_s=0.05)], 1)
    script.start_polling(2, [Poll(read(2), 1.0, phase_s=0.5)], 2)
    script.run_until(30)
    found = script.core.statistics(script.now)
    for address, count, delay_s in ((1, 300, 0.004), (2, 30, 0.008)):
        station = found.stations[address]
        assert station.transactions_per_s == pytest.approx(count / 30)
        assert station.load_percent == pytest.approx(100 * count * 21 * CHARACTER_S / 30)
        assert station.occupied_percent == pytest.approx(100 * count * (24.5 * CHARACTER_S + delay_s) / 30)
    assert _line_use(found.stations[3]) == (0, 0, 0)
    _adds_up(found)
    script.run_until(99)  # the window is the time since the end of the 512th last transaction, less than a minute
    found = script.core.statistics(script.now)
    ends = sorted(
        (result.received_at or 0) + 3.5 * CHARACTER_S for address in (1, 2) for result in script.results[address]
    )
    assert found.transactions_per_s == pytest.approx(511 / (99 - ends[-512]))
    assert found.stations[2].transactions_per_s == pytest.approx(46 / (99 - ends[-512]))
    _adds_up(found)


def test_the_recent_figures_of_a_slow_bus_look_back_a_minute() -> None:
    script = make_script(FakeStation(address=1))
    script.start_polling(1, [Poll(read(1), 2.0, phase_s=0.5)], 1)
    script.run_until(100)
    assert script.core.statistics(script.now).stations[1].transactions_per_s == pytest.approx(30 / 60)
    script._perform(script.core.stop_polling(1, script.now))
    script.run_until(200)
    assert _line_use(script.core.statistics(script.now)) == (0, 0, 0)


def test_the_counters_of_a_removed_drive_stay_with_the_bus_and_not_with_its_successor() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    for address in (1, 2):
        script.start_polling(address, [Poll(read(address), 0.1)], address)
    script.run_until(10)
    before = script.core.statistics(script.now)
    script._perform(script.core.remove_station(1, script.now))
    script.core.registry.add(station_config(1))
    after = script.core.statistics(script.now)
    assert replace(after, stations={}) == replace(before, stations={}) and before.replies > 0
    assert _line_use(after.stations[1]) == (0, 0, 0)
    assert _line_use(after.stations[2]) == _line_use(before.stations[2]) > (0, 0, 0)


def _line_use(found: StationStatistics) -> tuple[float, float, float]:
    return found.load_percent, found.occupied_percent, found.transactions_per_s


def _adds_up(found: BusStatistics) -> None:
    sums = [sum(shares) for shares in zip(*map(_line_use, found.stations.values()), strict=True)]
    assert sums == pytest.approx(_line_use(found)) and min(sums) > 0


def test_a_subscription_that_was_cancelled_while_its_station_was_silent_stays_cancelled() -> None:
    station = FakeStation(alive=False)
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 0.2)])
    script.run_until(3)
    script._perform(script.core.stop_polling("polls", script.now))
    station.alive = True
    script.run_until(200)
    assert station.received_requests and station.read_count == 0 and not script.core.stations[1].state.is_suspect


def test_a_station_removed_while_its_frame_is_out_is_forgotten() -> None:
    station = FakeStation(alive=False)
    script = make_script(station, FakeStation(address=2))
    script.submit(read_request(1), "gone")
    script.run_until(0.02)
    script._perform(script.core.remove_station(1, script.now))
    assert script.result("gone").error is not None
    count = len(script.sent)
    script.run_until(200)
    assert len(script.sent) == count and script.core.scheduler.untrusted_stations == []


def test_the_stop_bound_counts_frames_that_are_not_polled() -> None:
    """A write of C320 has 18 characters and its stop 15, where a poll and a sync probe have 14: 93 ms."""
    config = create_dialect(profiles.load("c320"), 1).station_config
    line = SerialSettings(9600, parity="E")
    found = estimate_bus_load([(config, [Poll(sunfar.ReadMonitor(1, 0), 0.5)])], line).drives[1].stop_bound_s
    assert found == pytest.approx(line.seconds(18 + 8 + 18 + 5 + 15) + 0.02)
    config = create_dialect(profiles.load("vc660"), 1).station_config
    found = (
        estimate_bus_load([(config, [Poll(modbus.ReadRegisters(1, 0x3001, 1), 0.5)])], SerialSettings())
        .drives[1]
        .stop_bound_s
    )
    assert found == pytest.approx(SerialSettings().seconds(8 + 3.5 + 13 + 3.5 + 8) + 0.024 + 0.02)
