"""The live gateway in virtual time: what a client is told, when, and how it ends."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest
from starlette.websockets import WebSocket

from drivebus.errors import ControlNotHeld, ServiceUnavailable
from drivebus.gateways.fanout import MAX_QUEUED_MESSAGES
from drivebus.gateways.upstream import UpstreamFeed
from drivebus.testing import virtual_time
from drivebus.web.live.endpoint import LIVE_ACTOR, MAX_WEBSOCKETS, LiveEndpoint
from drivebus.web.live.messages import parse_interval, parse_message, parse_patterns
from fixtures.live import FakeSubscriber, FakeWebSocket, Json, signal, snapshot, update
from fixtures.rest_api import FakeService

DRIVES = ("drives/*",)


def told(story: Callable[[FakeService, UpstreamFeed], Awaitable[None]]) -> None:
    async def play() -> None:
        plant = FakeService()
        feed = UpstreamFeed(plant, LIVE_ACTOR)
        await story(plant, feed)
        feed.close("shutdown")

    virtual_time.run(play())


def served(story: Callable[[FakeService, LiveEndpoint], Awaitable[None]]) -> None:
    async def play() -> None:
        plant = FakeService()
        await story(plant, LiveEndpoint(plant))

    virtual_time.run(play())


def begin(live: LiveEndpoint, socket: FakeWebSocket) -> asyncio.Task[None]:
    return asyncio.create_task(live.serve(cast(WebSocket, socket)))


def fan(**rest: Any) -> Json:
    return {"drives/fan-1": {"id": "fan-1", "state": "running"} | rest}


def test_a_client_gets_a_snapshot_and_then_what_changed() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        plant.messages.put_nowait(
            snapshot(alarms={"active": []}, drives__a={"state": "running", "start_inhibited": False})
        )
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(1.0)
        assert [one["type"] for one in ear.messages] == ["snapshot", "delta"]
        assert ear.topics() == [
            {"drives/a": {"state": "running", "start_inhibited": False}},
            {"drives/a": {"state": "stopped"}},
        ]
        assert [one["seq"] for one in ear.messages] == [0, 1] and ear.messages[0]["time_ms"] == 1

    told(story)


def test_the_plant_is_heard_once_for_all_and_a_message_is_encoded_once() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ears = [FakeSubscriber() for _ in range(50)]
        for ear in ears:
            feed.join(ear, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(1.0)
        assert plant.subscriptions == ["state"]
        assert len({id(ear.texts[1]) for ear in ears}) == 1

    told(story)


def test_who_comes_later_begins_where_the_others_are() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        first, later = FakeSubscriber(), FakeSubscriber()
        feed.join(first, DRIVES, 5.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(1.0)}}))
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(2.0)}}}))
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(3.0)}}}))
        await asyncio.sleep(0.1)
        feed.join(later, DRIVES, 5.0)
        values = [[one["drives/a"]["signals"]["f"]["value"] for one in ear.topics()] for ear in (first, later)]
        assert values == [[1.0, 3.0], [3.0]]
        assert first.messages[-1]["seq"] == later.messages[0]["seq"]

    told(story)


def test_values_come_at_the_clients_interval_and_the_last_one_wins() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 2.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(0.0)}}))
        for value in range(1, 41):
            await asyncio.sleep(0.25)
            plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(float(value))}}}))
        await asyncio.sleep(0.1)
        values = [
            (at, one["drives/a"]["signals"]["f"]["value"]) for at, one in zip(ear.at, ear.topics(), strict=True) if one
        ]
        assert values == [(0.0, 0.0)] + [(2.0 * n, 8.0 * n - 1.0) for n in range(1, 6)]

    told(story)


@pytest.mark.parametrize(
    "news",
    [
        {"drives/a": {"signals": {"f": signal(None, "bad")}}},
        {"drives/a": {"state": "fault"}},
        {"alarms": {"active": [{"id": "x"}]}},
        {"buses/l": {"is_open": False}},
        {"events": [{"id": "e"}]},
    ],
    ids=["trust", "state", "alarm", "port", "event"],
)
def test_what_matters_does_not_wait_for_a_slow_clients_interval(news: Json) -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, ("*",), 10.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(0.0)}}, buses__l={"is_open": True}))
        for _ in range(2):
            await asyncio.sleep(1.0)
            plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(1.0)}}}))
        await asyncio.sleep(0.1)
        before = len(ear.texts)
        plant.messages.put_nowait(update(news))
        await asyncio.sleep(0.25)
        assert len(ear.texts) == before + 1 and news.keys() <= ear.topics()[-1].keys()

    told(story)


def test_an_age_goes_on_while_a_message_waits() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear, later = FakeSubscriber(), FakeSubscriber()
        lease = {"owner": "li", "session": "s", "expires_ms": 9000}
        feed.join(ear, DRIVES, 10.0)
        fan = {"lease": lease, "signals": {"f": signal(1.0, source_time_ms=-499)}}
        plant.messages.put_nowait(snapshot(drives__a=fan))
        await asyncio.sleep(4.0)
        feed.join(later, DRIVES, 10.0)
        message = later.messages[0]
        drive = message["topics"]["drives/a"]
        age_ms = message["time_ms"] - drive["signals"]["f"]["source_time_ms"]
        assert (age_ms, drive["lease"]["expires_ms"]) == (4500, 9000)

    told(story)


def test_a_plant_that_falls_silent_has_no_heartbeat() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={}))
        for _ in range(3):
            await asyncio.sleep(1.0)
            plant.messages.put_nowait(update())
        await asyncio.sleep(60.0)
        assert ear.at == [0.0, 1.0, 2.0, 3.0] and ear.topics()[1:] == [{}, {}, {}]

    told(story)


def test_a_plant_that_is_gone_closes_everybody_and_nothing_old_is_shown_to_the_next() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear, next_one = FakeSubscriber(), FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait({"type": "closed", "reason": "shutdown", "text": {}})
        await asyncio.sleep(0.1)
        feed.join(next_one, DRIVES, 0.25)
        await asyncio.sleep(1.0)
        assert (ear.reason, next_one.texts) == ("shutdown", [])
        plant.messages.put_nowait(snapshot(drives__b={"state": "stopped"}))
        await asyncio.sleep(0.1)
        assert next_one.topics() == [{"drives/b": {"state": "stopped"}}]

    told(story)


def test_a_plant_that_begins_anew_lets_everybody_begin_anew() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        for name in ("drives__a", "drives__b"):
            plant.messages.put_nowait(snapshot(**{name: {"state": "running"}}))
        await asyncio.sleep(0.1)
        assert [(one["type"], list(one["topics"])) for one in ear.messages] == [
            ("snapshot", ["drives/a"]),
            ("snapshot", ["drives/b"]),
        ]

    told(story)


def test_a_plant_that_can_not_be_reached_says_so() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        async def unreachable(*_: Any) -> Any:
            raise ServiceUnavailable("plant.gone")
            yield

        plant.live = unreachable  # type: ignore[method-assign]
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        await asyncio.sleep(0.1)
        assert ear.reason == "upstream_lost"

    told(story)


def test_what_goes_away_and_what_was_dropped_is_told() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, ("drives/*", "events"), 0.25)
        plant.messages.put_nowait(snapshot(drives__a={}, events=[]))
        plant.messages.put_nowait(update({"events": [{"id": "1"}]}, removed=["drives/a"], missed={"events": 3}))
        await asyncio.sleep(0.5)
        last = ear.messages[-1]
        assert (last["removed"], last["missed"], last["topics"]) == (
            ["drives/a"],
            {"events": 3},
            {"events": [{"id": "1"}]},
        )

    told(story)


def test_what_went_and_came_back_while_a_message_waited_is_there() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, DRIVES, 10.0)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait(update(removed=["drives/a"]))
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(0.5)
        assert [one["topics"] for one in ear.messages][1:] == [{"drives/a": {"state": "stopped"}}]
        assert "removed" not in ear.messages[-1]

    told(story)


def test_more_items_than_a_message_holds_leave_the_oldest_out_and_say_how_many() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear = FakeSubscriber()
        feed.join(ear, ("frames/line-1",), 10.0)
        plant.messages.put_nowait(snapshot())
        await asyncio.sleep(0.1)
        frames = [{"n": n} for n in range(1, 1001)]
        plant.frames.put_nowait(update({"frames/line-1": frames[:1]}))
        plant.frames.put_nowait(update({"frames/line-1": frames[1:]}))
        await asyncio.sleep(11.0)
        last = ear.messages[-1]
        assert (len(last["topics"]["frames/line-1"]), last["topics"]["frames/line-1"][-1]) == (500, {"n": 1000})
        assert last["missed"] == {"frames/line-1": 500}

    told(story)


def test_frames_are_asked_of_the_plant_only_while_somebody_watches_them() -> None:
    async def story(plant: FakeService, feed: UpstreamFeed) -> None:
        ear, other = FakeSubscriber(), FakeSubscriber()
        feed.join(ear, DRIVES, 0.25)
        channel = feed.join(other, ("frames/line-1",), 0.25)
        await asyncio.sleep(0.1)
        assert sorted(plant.subscriptions) == ["frames/line-1", "state"]
        feed.leave(other, channel)
        feed.join(other, ("frames/line-1",), 0.25)
        await asyncio.sleep(0.1)
        assert len(plant.subscriptions) == 3

    told(story)


def test_a_slow_client_is_closed_with_the_reason_and_holds_nobody_up() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        slow, quick = FakeWebSocket(takes=False), FakeWebSocket()
        tasks = [begin(live, socket) for socket in (slow, quick)]
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(snapshot())
        for n in range(MAX_QUEUED_MESSAGES + 2):
            await asyncio.sleep(0.25)
            plant.messages.put_nowait(update({"drives/a": {"state": str(n)}}))
        await asyncio.sleep(2.0)
        assert (slow.closed, quick.closed) == ((4008, "slow"), None)
        assert len(quick.sent) == MAX_QUEUED_MESSAGES + 3 and live.open == 1
        quick.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    served(story)


def test_a_client_that_leaves_is_forgotten() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        task = begin(live, socket)
        await asyncio.sleep(0.1)
        socket.incoming.put_nowait(None)
        await task
        assert (socket.closed, live.open) == (None, 0)
        plant.messages.put_nowait(snapshot(drives__a={}))
        await asyncio.sleep(1.0)
        assert socket.sent == []

    served(story)


def test_a_subscription_is_changed_while_it_runs() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        socket.query_params = {"topics": "alarms"}
        task = begin(live, socket)
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(snapshot(alarms={"active": []}, drives__a={"state": "running"}))
        await asyncio.sleep(0.1)
        socket.incoming.put_nowait('{"subscribe": ["drives/a"]}')
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"alarms": {"active": [{"id": "x"}]}}))
        await asyncio.sleep(0.5)
        assert [list(one["topics"]) for one in socket.sent if one["topics"]] == [["alarms"], ["drives/a"]]
        socket.incoming.put_nowait(None)
        await task

    served(story)


def test_a_lease_is_renewed_once_for_each_ask_in_the_name_of_the_session() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        plant.results["lease.renew"] = {"lease": {"owner": "li"}, "ttl_s": 10}
        socket = FakeWebSocket()
        task = begin(live, socket)
        socket.incoming.put_nowait('{"renew": ["fan-1"]}')
        await asyncio.sleep(60.0)
        assert [(name, params, actor.session) for name, params, actor in plant.calls] == [
            ("lease.renew", {"drive": "fan-1"}, "s-li")
        ]
        plant.results["lease.renew"] = ControlNotHeld("plant.not_owner", drive="fan-1")
        socket.incoming.put_nowait('{"renew": ["fan-1"]}')
        await asyncio.sleep(1.0)
        assert socket.sent[0] == {"type": "lease", "drive": "fan-1", "lease": {"owner": "li"}, "ttl_s": 10}
        assert socket.sent[1]["error"]["kind"] == "ControlNotHeld"
        socket.incoming.put_nowait(None)
        await task

    served(story)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"subscribe": "drives/*"}',
        '{"subscribe": ["../etc"]}',
        '{"subscribe": [1]}',
        '{"subscribe": ["' + "a" * 100 + '"]}',
        '{"subscribe": ["alarms"' + ', "alarms"' * 100 + "]}",
        '{"renew": ["fan-1", null]}',
        '{"run": ["fan-1"]}',
        "[" * 16_000,
        '{"renew": [' + " " * 20_000 + "]}",
    ],
    ids=lambda text: text[:30],
)
def test_a_message_that_nobody_understands_ends_the_connection(text: str) -> None:
    with pytest.raises(ValueError):
        parse_message(text)

    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        task = begin(live, socket)
        socket.incoming.put_nowait(text)
        await task
        assert (socket.closed, socket.sent[-1]["reason"]) == ((4400, "bad_message"), "bad_message")

    served(story)


def test_too_many_messages_end_the_connection() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket, patient = FakeWebSocket(), FakeWebSocket()
        tasks = [begin(live, socket), begin(live, patient)]
        for _ in range(200):
            socket.incoming.put_nowait('{"subscribe": []}')
        for _ in range(200):
            patient.incoming.put_nowait('{"subscribe": []}')
            await asyncio.sleep(0.11)
        assert (socket.closed, patient.closed) == ((4029, "rate_limited"), None)
        patient.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    served(story)


def test_so_many_websockets_and_no_more() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        sockets = [FakeWebSocket() for _ in range(MAX_WEBSOCKETS + 1)]
        tasks = [begin(live, socket) for socket in sockets]
        await asyncio.sleep(0.1)
        assert [socket.closed for socket in sockets] == [None] * MAX_WEBSOCKETS + [(1013, "many")]
        for socket in sockets:
            socket.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    served(story)


@pytest.mark.parametrize("query", [{"interval": "0.05"}, {"interval": "11"}, {"interval": "nan"}, {"topics": "x"}])
def test_an_address_that_asks_for_the_impossible_is_closed_at_once(query: dict[str, str]) -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        socket.query_params = query
        await live.serve(cast(WebSocket, socket))
        assert (socket.closed, plant.subscriptions) == ((4400, "bad_message"), [])

    served(story)


def test_a_fast_client_shares_the_subscription_of_the_others() -> None:
    async def story(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        socket.query_params = {"interval": "0.1"}
        task = begin(live, socket)
        await asyncio.sleep(0.1)
        assert plant.subscriptions == ["state"]
        socket.incoming.put_nowait(None)
        await task

    served(story)


def test_wishes_that_mean_the_same_share_a_channel() -> None:
    assert parse_patterns(["plant", "alarms", "plant"]) == ("alarms", "plant")
    assert [parse_interval(text) for text in (None, "1", "0.26", "0.1")] == [0.25, 1.0, 0.25, 0.1]
    assert parse_message(json.dumps({"subscribe": ["*"], "renew": ["a"]})).renew == ("a",)
