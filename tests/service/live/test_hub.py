"""The hub: deltas, ages, silence shown on it, slow readers closed with a reason (G17, I12)."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.service.control.leases import LEASE_TTL_S
from drivebus.service.live.hub import Hub
from drivebus.service.live.subscription import MAX_BURST_ITEMS, MAX_QUEUED_HUB_MESSAGES
from drivebus.service.live.topics import AgeingValue
from drivebus.service.runtime.fairness import yield_to_loop
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run
from drivebus.values import Quality
from fixtures.service import LOCAL, ServiceKit, remote_actor, running_service

Json = dict[str, Any]


def hub() -> Hub:
    loop = asyncio.get_running_loop()
    return Hub(loop.time, lambda: int(loop.time() * 1000))


def test_only_what_changed_is_told_and_the_latest_wins() -> None:
    async def story() -> None:
        one = hub()
        one.publish("drives/a", {"state": "stopped", "signals": {"x": 1, "y": 2}})
        live = one.live(["drives/*"], 0.25)
        assert (await anext(live))["topics"] == {"drives/a": {"state": "stopped", "signals": {"x": 1, "y": 2}}}
        one.publish("drives/a", {"state": "stopped", "signals": {"x": 5, "y": 2}})
        one.publish("drives/a", {"state": "stopped", "signals": {"x": 6, "y": 2}})
        one.publish("other", {"z": 1})
        found = await anext(live)
        assert found["topics"] == {"drives/a": {"signals": {"x": 6}}} and found["seq"] == 2

    run(story())


def test_what_only_grows_older_is_no_change_and_its_age_is_that_of_the_message() -> None:
    async def story() -> None:
        one = hub()
        await asyncio.sleep(10)
        one.publish("drives/a", {"signals": {"x": AgeingValue({"value": 1}, "age_s", 8.0)}})
        live = one.live(["*"], 0.25)
        assert (await anext(live))["topics"]["drives/a"]["signals"]["x"] == {"value": 1, "age_s": 2.0}
        one.publish("drives/a", {"signals": {"x": AgeingValue({"value": 1}, "age_s", 8.0)}})
        assert (await anext(live))["topics"] == {}

    run(story())


def test_a_quiet_hub_still_beats_every_second() -> None:
    async def story() -> None:
        one, loop = hub(), asyncio.get_running_loop()
        live = one.live(["*"], 0.25)
        await anext(live)
        begun = loop.time()
        for _ in range(3):
            assert (await anext(live))["topics"] == {}
        assert loop.time() - begun == 3.0

    run(story())


def test_what_is_gone_is_told() -> None:
    async def story() -> None:
        one = hub()
        one.publish("drives/a", {"state": "stopped"})
        live = one.live(["drives/*"])
        await anext(live)
        one.publish("drives/a", {"state": "running"})
        one.remove("drives/a")
        found = await anext(live)
        assert found["gone"] == ["drives/a"] and found["topics"] == {}

    run(story())


def test_what_comes_while_one_listens_is_told_whole_with_its_signals() -> None:
    async def story() -> None:
        one = hub()
        live = one.live(["drives/*"])
        assert (await anext(live))["topics"] == {}
        one.publish("drives/a", {"state": "stopped", "signals": {"x": 1, "y": 2}})
        assert (await anext(live))["topics"] == {"drives/a": {"state": "stopped", "signals": {"x": 1, "y": 2}}}

    run(story())


def test_what_went_and_came_back_is_told_whole_and_not_as_gone() -> None:
    async def story() -> None:
        one = hub()
        one.publish("drives/a", {"state": "running", "signals": {"x": 1, "y": 2}})
        live = one.live(["drives/*"])
        await anext(live)
        one.remove("drives/a")
        one.publish("drives/a", {"state": "running", "signals": {"x": 1, "y": 3}})
        found = await anext(live)
        assert "gone" not in found
        assert found["topics"] == {"drives/a": {"state": "running", "signals": {"x": 1, "y": 3}}}

    run(story())


def test_of_a_list_only_what_is_above_a_number_is_given() -> None:
    async def story() -> None:
        one = hub()
        assert [one.append("events", name) for name in "abc"] == [1, 2, 3]
        assert one.items("events", 1) == [(2, "b"), (3, "c")] and one.items("events", one.last_number("events")) == []
        live = one.live(["events"])
        assert (await anext(live))["topics"] == {"events": ["a", "b", "c"]}
        one.append("events", "d")
        found = await anext(live)
        assert found["topics"] == {"events": ["d"]} and "dropped" not in found

    run(story())


def test_lists_append_are_bounded_and_say_what_was_dropped() -> None:
    async def story() -> None:
        one = hub()
        live = one.live(["events"])
        await anext(live)
        for number in range(MAX_BURST_ITEMS + 7):
            one.append("events", {"n": number})
        found = await anext(live)
        assert [item["n"] for item in found["topics"]["events"]] == [*range(7, MAX_BURST_ITEMS + 7)]
        assert found["dropped"] == {"events": 7}

    run(story())


def test_a_reader_that_does_not_read_is_closed_with_the_reason_and_holds_nothing() -> None:
    async def story() -> None:
        one = hub()
        live = one.live(["*"], 0.1)
        await anext(live)
        for number in range(10 * MAX_QUEUED_HUB_MESSAGES):
            one.publish("drives/a", {"n": number})
            await asyncio.sleep(0.1)
        found = await anext(live)
        assert found["type"] == "closed" and found["reason"] == "slow" and found["text"]["zh"]
        assert [message async for message in live] == []
        assert one.listeners == 0

    run(story())


def test_a_listener_that_goes_away_is_forgotten() -> None:
    async def story() -> None:
        one = hub()
        live = one.live(["*"])
        await anext(live)
        assert one.listeners == 1
        await live.aclose()  # type: ignore[attr-defined]
        assert one.listeners == 0

    run(story())


def test_a_lease_runs_out_on_the_hub_without_being_told_again() -> None:
    """What is left of it is that of the message, down to nothing."""

    async def story() -> None:
        ann = remote_actor("ann")
        async with running_service() as kit:
            await asyncio.sleep(1)
            now = kit.service.plant.now
            await kit.call("lease.take", ann, drive="fan-1")
            until = now() + LEASE_TTL_S
            await asyncio.sleep(2)
            told = kit.service.plant.hub.topic("drives/fan-1")["lease"]
            left = pytest.approx(until - now(), abs=0.01)
            assert told == {"owner": "ann", "session": ann.session, "expires_in_s": left}
        assert AgeingValue({}, "expires_in_s", 10.0, left=True).json(10.5) == {"expires_in_s": 0.0}

    run(story())


async def latest(live: Any, known: Json) -> None:
    """Merge one message as every client does."""
    message = await anext(live)
    for topic, changed in message["topics"].items():
        signals = {**known.get(topic, {}).get("signals", {}), **changed.get("signals", {})}
        known[topic] = {**known.get(topic, {}), **changed, "signals": signals}


def test_a_silent_drive_is_bad_everywhere_in_time() -> None:
    """G17: hub, request and history; within max(3 periods, 1 s) and the timeout."""

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live, known = kit.service.live(["drives/fan-1"], LOCAL), {}
            await latest(live, known)
            assert known["drives/fan-1"]["signals"]["output_frequency"]["quality"] == "good"
            silence(kit)
            fed = len(kit.history.samples)
            begun = kit.service.plant.now()
            while known["drives/fan-1"]["signals"]["output_frequency"]["quality"] != "bad":
                await latest(live, known)
            period = kit.service.plant.drives["fan-1"].profile.signals["output_frequency"].period_s
            assert kit.service.plant.now() - begun <= max(3 * period, 1.0) + 0.5 + 0.25 + 0.25
            view = await kit.call("drives.get", drive="fan-1")
            assert view["signals"]["output_frequency"]["quality"] == "bad"
            await asyncio.sleep(20)
            gaps = [s for s in kit.history.samples[fed:] if s.tag == "fan-1.output_frequency" and s.value is None]
            assert len(gaps) == 1

    run(story())


def test_a_gap_is_recorded_once_and_only_after_a_value() -> None:
    """What was never read has no gap: nothing went."""

    async def story() -> None:
        async with running_service() as kit:
            kit.station("fan-2").faults.silent = True
            await asyncio.sleep(5)
            readings = kit.service.plant.drives["fan-1"].status().readings
            good = {"output_frequency": readings["output_frequency"]}
            bad = {"output_frequency": replace(good["output_frequency"], quality=Quality.BAD)}
            fan_2 = kit.service.plant.drives["fan-2"]
            samples = [one for readings in (bad, good, good, bad, bad) for one in fan_2.new_samples(readings, 0)]
            assert [one.value for one in samples if one.tag == "fan-2.output_frequency"] == [0.0, None]

    run(story())


def silence(kit: ServiceKit) -> None:
    """The drive's plug is pulled."""
    bench = kit.service.plant.drives["fan-1"].bus.port.simulated_bus  # type: ignore[attr-defined]
    bench.stations.remove(bench.station(1))
    bench._group_stations()


def test_a_drive_that_falls_silent_is_told_once_as_are_its_return_and_fault(caplog: pytest.LogCaptureFixture) -> None:
    """On the hub, and as one line of the log each."""
    caplog.set_level("INFO", "drivebus.service")

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            bench = kit.service.plant.drives["fan-1"].bus.port.simulated_bus  # type: ignore[attr-defined]
            station = bench.station(1)
            station.trip(Trip.OVERHEAT)
            await asyncio.sleep(5)
            silence(kit)
            await asyncio.sleep(120)
            bench.stations.append(station)
            bench._group_stations()
            await asyncio.sleep(120)
            events = [event for _, event in kit.service.plant.hub.items("events") if event["drive"] == "fan-1"]
            assert [event["text"]["en"] for event in events if event["kind"] in ("presence", "fault")] == [
                "fault Fu.7: see the fault table of the C320 manual",
                "fan-1 does not answer any more",
                "fan-1 answers again",
            ]
            logged = [r.getMessage() for r in caplog.records if getattr(r, "event", {}).get("drive") == "fan-1"]
            assert len(logged) == 3

    run(story())


def test_frames_are_decoded_for_whoever_looks() -> None:
    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live = kit.service.live(["frames/a"], LOCAL)
            await anext(live)
            found = await anext(live)
            frames = found["topics"]["frames/a"]
            assert {frame["kind"] for frame in frames} <= {"sent", "reply"}
            assert all(frame["text"]["en"] and frame["text"]["zh"] and frame["hex"] for frame in frames)
            assert ", " in frames[-1]["text"]["en"] and "，" in frames[-1]["text"]["zh"]
            kept = await kit.call("buses.frames", bus="a", station=2, limit=5)
            assert [frame["station"] for frame in kept["frames"]] == [2] * 5
            later = await kit.call("buses.frames", bus="a", after=kept["last"])
            assert later["frames"] == []

    run(story())


def test_a_bus_shows_its_load_and_its_drives_in_cable_order() -> None:
    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(10)
            found = await kit.call("buses.get", bus="a")
            assert [station["drive"] for station in found["stations"]] == ["fan-1", "fan-2"]
            assert found["is_open"] and 0 < found["load_percent"] < 100 and found["stop_bound_s"] < 0.5
            assert found["line"] == "9600 8E1"

    run(story())


def test_g17_who_asks_a_lot_holds_no_live_values_up() -> None:
    """A snapshot and a delta of 160 topics have 20 turns each, while 200 questions wait for theirs."""

    async def story() -> None:
        one, loop, asked = hub(), asyncio.get_running_loop(), list[asyncio.Task[None]]()

        def ask() -> None:
            asked[:] = [loop.create_task(yield_to_loop()) for _ in range(200)]

        async def told() -> int:
            await anext(live)
            return sum(question.done() for question in asked)

        live = one.live(["*"], 0.25)
        for number in range(2):
            for topic in range(160):
                one.publish(f"drives/{topic}", {"state": number})
            if number == 0:
                ask()
            assert 15 <= await told() <= 30
            await asyncio.gather(*asked)
            loop.call_later(0.25, ask)

    run(story())
