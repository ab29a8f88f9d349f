"""Hub: whole objects with absolute times, pushed when they change."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.service.config.adapter_latency import AdapterLatency
from drivebus.service.control.leases import LEASE_TTL_S
from drivebus.service.live.hub import MAX_LIST_ITEMS, STATE_STREAM, Hub
from drivebus.service.runtime.fairness import encode_json_cooperatively, yield_to_loop
from drivebus.service.runtime.utc_clock import UtcClock
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Text
from fixtures.service import LOCAL, ServiceKit, remote_actor, running_service


def new_hub() -> Hub:
    loop = asyncio.get_running_loop()
    return Hub(lambda: int(loop.time() * 1000))


def test_a_changed_topic_is_pushed_whole_and_only_its_newest_content() -> None:
    async def scenario() -> None:
        hub = new_hub()
        hub.publish("drives/a", {"state": "stopped", "signals": {"x": 1, "y": 2}})
        live = hub.subscribe(STATE_STREAM)
        first = await anext(live)
        assert first["topics"] == {"drives/a": {"state": "stopped", "signals": {"x": 1, "y": 2}}}
        hub.publish("drives/a", {"state": "stopped", "signals": {"x": 5, "y": 2}})
        hub.publish("drives/a", {"state": "stopped", "signals": {"x": 6, "y": 2}})
        found = await anext(live)
        assert found["type"] == "update"
        assert found["topics"] == {"drives/a": {"state": "stopped", "signals": {"x": 6, "y": 2}}}

    run(scenario())


def test_a_change_is_pushed_at_once() -> None:
    async def scenario() -> None:
        hub, loop = new_hub(), asyncio.get_running_loop()
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        loop.call_later(0.1, hub.publish, "drives/a", {"state": "running"})
        assert (await anext(live))["topics"] == {"drives/a": {"state": "running"}} and loop.time() == 0.1

    run(scenario())


def test_an_equal_object_is_no_change() -> None:
    async def scenario() -> None:
        hub = new_hub()
        hub.publish("drives/a", {"state": "stopped"})
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        hub.publish("drives/a", {"state": "stopped"})
        assert (await anext(live))["topics"] == {}

    run(scenario())


def test_a_quiet_hub_sends_a_heartbeat_every_second() -> None:
    async def scenario() -> None:
        hub, loop = new_hub(), asyncio.get_running_loop()
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        started_at = loop.time()
        for _ in range(3):
            assert (await anext(live))["topics"] == {}
        assert loop.time() - started_at == 3.0

    run(scenario())


def test_a_removed_topic_is_reported() -> None:
    async def scenario() -> None:
        hub = new_hub()
        hub.publish("drives/a", {"state": "stopped"})
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        hub.publish("drives/a", {"state": "running"})
        hub.remove("drives/a")
        found = await anext(live)
        assert found["removed"] == ["drives/a"] and found["topics"] == {}

    run(scenario())


def test_a_topic_that_was_removed_and_published_again_is_not_reported_as_removed() -> None:
    async def scenario() -> None:
        hub = new_hub()
        hub.publish("drives/a", {"state": "running"})
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        hub.remove("drives/a")
        hub.publish("drives/a", {"state": "stopped"})
        found = await anext(live)
        assert "removed" not in found and found["topics"] == {"drives/a": {"state": "stopped"}}

    run(scenario())


def test_of_a_list_only_new_items_are_sent() -> None:
    async def scenario() -> None:
        hub = new_hub()
        assert [hub.append("events", name) for name in "abc"] == [1, 2, 3]
        assert hub.items("events", 1) == [(2, "b"), (3, "c")] and hub.items("events", 3) == []
        live = hub.subscribe(STATE_STREAM)
        assert (await anext(live))["topics"] == {"events": ["a", "b", "c"]}
        hub.append("events", "d")
        found = await anext(live)
        assert found["topics"] == {"events": ["d"]} and "missed" not in found

    run(scenario())


def test_lists_are_bounded_and_the_items_that_were_dropped_are_counted() -> None:
    async def scenario() -> None:
        hub = new_hub()
        hub.append("events", {"n": -1})
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        for number in range(MAX_LIST_ITEMS + 7):
            hub.append("events", {"n": number})
        found = await anext(live)
        assert [item["n"] for item in found["topics"]["events"]] == [*range(7, MAX_LIST_ITEMS + 7)]
        assert found["missed"] == {"events": 7}

    run(scenario())


def test_a_slow_reader_gets_only_the_newest_content_of_each_topic() -> None:
    async def scenario() -> None:
        hub = new_hub()
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        for number in range(1000):
            hub.publish("drives/a", {"n": number})
            await asyncio.sleep(0.1)
        assert (await anext(live))["topics"] == {"drives/a": {"n": 999}}
        assert (await anext(live))["topics"] == {}

    run(scenario())


def test_a_closed_stream_removes_its_subscriber() -> None:
    async def scenario() -> None:
        hub = new_hub()
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        assert hub.subscriber_count == 1
        await live.aclose()  # type: ignore[attr-defined]
        assert hub.subscriber_count == 0

    run(scenario())


def test_a_closed_hub_ends_every_stream_with_the_reason() -> None:
    async def scenario() -> None:
        hub = new_hub()
        live = hub.subscribe(STATE_STREAM)
        await anext(live)
        hub.close()
        messages = [message async for message in live]
        assert [message["reason"] for message in messages] == ["shutdown"] and messages[0]["text"]["zh"]

    run(scenario())


def test_a_drive_is_published_with_each_reply_and_not_only_with_each_cycle() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live, times = kit.service.live(STATE_STREAM, LOCAL), set()
            started_at = kit.service.plant.now()
            while kit.service.plant.now() - started_at < 4.0:
                changed = (await anext(live))["topics"]
                if "drives/fan-1" in changed:
                    times.add(changed["drives/fan-1"]["signals"]["output_frequency"]["source_time_ms"])
            period_s = kit.service.plant.drives["fan-1"].profile.signals["output_frequency"].period_s
            assert len(times) >= 4.0 / period_s - 1

    run(scenario())


def test_a_wall_clock_that_is_set_changes_no_age() -> None:
    wall_s = 0.0

    async def scenario() -> None:
        nonlocal wall_s
        loop = asyncio.get_running_loop()
        clock = UtcClock(loop.time, lambda: int((loop.time() + wall_s) * 1000))
        await asyncio.sleep(10)
        assert (clock.now_ms(), clock.utc_ms(8.0)) == (10_000, 8000)
        for wall_s in (3600.0, -3600.0):
            assert clock.now_ms() - clock.utc_ms(8.0) == 2000
            clock.follow_wall_clock()
            assert clock.now_ms() - clock.utc_ms(8.0) == 2000
            assert clock.now_ms() == 10_000 + wall_s * 1000
        clock.follow_wall_clock()
        wall_s += 0.5
        clock.follow_wall_clock()
        assert clock.now_ms() == 10_000 - 3_600_000, "a small correction moves no label"

    run(scenario())


def test_a_lease_is_published_with_its_end_and_not_again_until_it_is_renewed() -> None:
    async def scenario() -> None:
        ann = remote_actor("ann")
        async with running_service() as kit:
            await asyncio.sleep(1)
            plant = kit.service.plant
            await kit.call("lease.take", ann, drive="fan-1")
            expires_ms = plant.clock.utc_ms(plant.now() + LEASE_TTL_S)
            await asyncio.sleep(2)
            lease = plant.hub.topics["drives/fan-1"]["lease"]
            assert lease == {"owner": "ann", "session": ann.session, "remote": True, "expires_ms": expires_ms}

    run(scenario())


def test_an_offline_drive_has_bad_quality_in_live_values_queries_and_history_in_time() -> None:
    """Within max(3 periods, 1 s) and the timeout."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live, known = kit.service.live(STATE_STREAM, LOCAL), {}
            known |= (await anext(live))["topics"]
            assert known["drives/fan-1"]["signals"]["output_frequency"]["quality"] == "good"
            disconnect(kit)
            before = len(kit.history.samples)
            started_at = kit.service.plant.now()
            while known["drives/fan-1"]["signals"]["output_frequency"]["quality"] != "bad":
                known |= (await anext(live))["topics"]
            period = kit.service.plant.drives["fan-1"].profile.signals["output_frequency"].period_s
            assert kit.service.plant.now() - started_at <= max(3 * period, 1.0) + 0.5 + 0.25 + 0.25
            view = await kit.call("drives.get", drive="fan-1")
            assert view["signals"]["output_frequency"]["quality"] == "bad"
            await asyncio.sleep(20)
            gaps = [s for s in kit.history.samples[before:] if s.tag == "fan-1.output_frequency" and s.value is None]
            assert len(gaps) == 1

    run(scenario())


def test_a_gap_is_recorded_once_and_only_after_a_value() -> None:
    """A signal that was never read has no gap."""

    async def scenario() -> None:
        async with running_service() as kit:
            kit.station("fan-2").faults.silent = True
            await asyncio.sleep(5)
            readings = kit.service.plant.drives["fan-1"].status().readings
            good = {"output_frequency": readings["output_frequency"]}
            bad = {"output_frequency": replace(good["output_frequency"], quality=Quality.BAD)}
            fan_2 = kit.service.plant.drives["fan-2"]
            samples = [sample for readings in (bad, good, good, bad, bad) for sample in fan_2.new_samples(readings, 0)]
            assert [sample.value for sample in samples if sample.tag == "fan-2.output_frequency"] == [0.0, None]

    run(scenario())


def disconnect(kit: ServiceKit) -> None:
    """Remove the drive from its bus."""
    bench = kit.simulated_bus("fan-1")
    bench.stations.remove(bench.station(1))
    bench._group_stations()


def test_a_lost_drive_its_return_and_its_fault_are_each_one_event(caplog: pytest.LogCaptureFixture) -> None:
    """Each is one line of the log, too."""
    caplog.set_level("INFO", "drivebus.service")

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            bench = kit.simulated_bus("fan-1")
            station = bench.station(1)
            station.trip(Trip.OVERHEAT)
            await asyncio.sleep(5)
            disconnect(kit)
            await asyncio.sleep(120)
            bench.stations.append(station)
            bench._group_stations()
            await asyncio.sleep(120)
            events = [event for _, event in kit.service.plant.hub.items("events") if event["drive"] == "fan-1"]
            assert [event["text"]["en"] for event in events if event["kind"] in ("presence", "fault")] == [
                "fault Fu.7: see the fault table of the C320 manual",
                "Fan 1 no longer replies",
                "Fan 1 replies again",
            ]
            logged = [r.getMessage() for r in caplog.records if getattr(r, "event", {}).get("drive") == "fan-1"]
            assert len(logged) == 3

    run(scenario())


def test_frames_are_decoded_for_a_subscriber() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live = kit.service.live("frames/a", LOCAL)
            await anext(live)
            found = await anext(live)
            frames = found["topics"]["frames/a"]
            assert {frame["kind"] for frame in frames} <= {"sent", "reply"}
            assert all(frame["text"]["en"] and frame["text"]["zh"] and frame["hex"] for frame in frames)
            assert ", " in frames[-1]["text"]["en"] and "，" in frames[-1]["text"]["zh"]
            listed = await kit.call("buses.frames", bus="a", station=2, limit=5)
            assert [frame["station"] for frame in listed["frames"]] == [2] * 5
            later = await kit.call("buses.frames", bus="a", after=listed["last"])
            assert later["frames"] == []

    run(scenario())


def test_a_bus_shows_its_load_and_its_drives_in_cable_order() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(10)
            found = await kit.call("buses.get", bus="a")
            assert [station["drive"] for station in found["stations"]] == ["fan-1", "fan-2"]
            assert found["is_open"] and 0 < found["load_percent"] < 100 and found["stop_bound_s"] < 0.5
            assert found["serial"] == "9600 8E1"

    run(scenario())


def test_a_bus_shows_what_a_slow_adapter_costs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The port of the fake plant has no latency timer, so the measured one is replaced."""
    slow = AdapterLatency(bus="a", device="ttyUSB7", latency_ms=16, polls_per_s=12.34, polls_per_s_at_low_latency=20.0)

    async def scenario() -> None:
        async with running_service() as kit:
            assert (await kit.call("buses.get", bus="a"))["slow_adapter"] is None
            monkeypatch.setattr("drivebus.service.runtime.bus.adapter_latency", lambda *_: slow)
            await asyncio.sleep(2)
            shown = (await kit.call("buses.get", bus="a"))["slow_adapter"]
            assert all("ttyUSB7" in shown[language] and "12.3" in shown[language] for language in ("en", "zh"))
            assert (shown["en"][:5], shown["zh"][:6]) == ("bus a", "总线 a：适"), "the plant gives it no title"
            bus = kit.service.plant.buses["a"]
            bus.config = replace(bus.config, title=Text("Fan line", "风机线路"))
            await asyncio.sleep(2)
            shown = (await kit.call("buses.get", bus="a"))["slow_adapter"]
            assert (shown["en"][:13], shown["zh"][:5]) == ("Fan line: the", "风机线路：")

    run(scenario())


def test_many_requests_do_not_delay_live_values() -> None:
    """A message of 160 topics is encoded in some 20 pieces, while 200 requests wait for their turns."""

    async def scenario() -> None:
        hub, loop = new_hub(), asyncio.get_running_loop()
        for topic in range(160):
            hub.publish(f"drives/{topic}", {"state": "x" * 4000})
        message = await anext(hub.subscribe(STATE_STREAM))
        requests = [loop.create_task(yield_to_loop()) for _ in range(200)]
        await encode_json_cooperatively(message, internal=True)
        assert 15 <= sum(request.done() for request in requests) <= 30
        await asyncio.gather(*requests)

    run(scenario())
