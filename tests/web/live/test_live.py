"""Live values in virtual time: messages of a client, their times, and the end of a connection."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Awaitable, Callable
from fnmatch import fnmatchcase
from typing import Any, cast

import pytest
from starlette.websockets import WebSocket

from drivebus.errors import ControlNotHeld, ServiceUnavailable
from drivebus.gateways.fanout import MAX_QUEUED_MESSAGES, matches_topic
from drivebus.gateways.upstream import UpstreamFeed
from drivebus.service.auth.rights import Role
from drivebus.testing import virtual_time
from drivebus.web.live.endpoint import LIVE_ACTOR, MAX_WEBSOCKETS, LiveEndpoint
from drivebus.web.live.messages import MAX_PATTERNS, MAX_RENEWALS, parse_interval, parse_message, parse_patterns
from fixtures.live import FakeSubscriber, FakeWebSocket, Json, signal, snapshot, update
from fixtures.rest_api import FakeService
from fixtures.service import remote_actor

DRIVES = ("drives/*",)


def run_feed(scenario: Callable[[FakeService, UpstreamFeed], Awaitable[None]]) -> None:
    async def main() -> None:
        plant = FakeService()
        feed = UpstreamFeed(plant, LIVE_ACTOR)
        await scenario(plant, feed)
        feed.close("shutdown")

    virtual_time.run(main())


def run_endpoint(scenario: Callable[[FakeService, LiveEndpoint], Awaitable[None]]) -> None:
    async def main() -> None:
        plant = FakeService()
        await scenario(plant, LiveEndpoint(plant))

    virtual_time.run(main())


def begin(live: LiveEndpoint, socket: FakeWebSocket) -> asyncio.Task[None]:
    return asyncio.create_task(live.serve(cast(WebSocket, socket)))


def fan(**rest: Any) -> Json:
    return {"drives/fan-1": {"id": "fan-1", "state": "running"} | rest}


def test_a_client_gets_a_snapshot_and_then_what_changed() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        plant.messages.put_nowait(
            snapshot(alarms={"active": []}, drives__a={"state": "running", "start_inhibited": False})
        )
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(1.0)
        assert [message["type"] for message in subscriber.messages] == ["snapshot", "delta"]
        assert subscriber.topics() == [
            {"drives/a": {"state": "running", "start_inhibited": False}},
            {"drives/a": {"state": "stopped"}},
        ]
        assert [message["seq"] for message in subscriber.messages] == [0, 1] and subscriber.messages[0]["time_ms"] == 1

    run_feed(scenario)


def test_all_clients_share_one_subscription_and_a_message_is_encoded_once() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscribers = [FakeSubscriber() for _ in range(50)]
        for subscriber in subscribers:
            feed.join(subscriber, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(1.0)
        assert plant.subscriptions == ["state"]
        assert len({id(subscriber.texts[1]) for subscriber in subscribers}) == 1

    run_feed(scenario)


def test_a_signal_that_a_replaced_drive_no_longer_has_is_null_at_once() -> None:
    """Regression: a client that merges deltas kept the last value of the model before."""

    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        client = FakeSubscriber()
        feed.join(client, DRIVES, 5.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(1.0), "old": signal(1.0)}}))
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(2.0)}}}))
        await asyncio.sleep(0.5)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(2.0)}}}))
        await asyncio.sleep(5.0)
        _, *deltas = client.topics()
        assert [delta["drives/a"]["signals"] for delta in deltas] == [{"f": signal(2.0), "old": None}]

    run_feed(scenario)


def test_a_later_client_gets_a_snapshot_of_the_current_state() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        first, later = FakeSubscriber(), FakeSubscriber()
        feed.join(first, DRIVES, 5.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(1.0)}}))
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(2.0)}}}))
        await asyncio.sleep(0.1)
        plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(3.0)}}}))
        await asyncio.sleep(0.1)
        feed.join(later, DRIVES, 5.0)
        values = [
            [topics["drives/a"]["signals"]["f"]["value"] for topics in subscriber.topics()]
            for subscriber in (first, later)
        ]
        assert values == [[1.0, 3.0], [3.0]]
        assert first.messages[-1]["seq"] == later.messages[0]["seq"]

    run_feed(scenario)


def test_values_come_at_the_clients_interval_and_the_last_one_wins() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 2.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(0.0)}}))
        for value in range(1, 41):
            await asyncio.sleep(0.25)
            plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(float(value))}}}))
        await asyncio.sleep(0.1)
        values = [
            (at, topics["drives/a"]["signals"]["f"]["value"])
            for at, topics in zip(subscriber.at, subscriber.topics(), strict=True)
            if topics
        ]
        assert values == [(0.0, 0.0)] + [(2.0 * n, 8.0 * n - 1.0) for n in range(1, 6)]

    run_feed(scenario)


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
def test_urgent_changes_do_not_wait_for_a_slow_clients_interval(news: Json) -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, ("*",), 10.0)
        plant.messages.put_nowait(snapshot(drives__a={"signals": {"f": signal(0.0)}}, buses__l={"is_open": True}))
        for _ in range(2):
            await asyncio.sleep(1.0)
            plant.messages.put_nowait(update({"drives/a": {"signals": {"f": signal(1.0)}}}))
        await asyncio.sleep(0.1)
        before = len(subscriber.texts)
        plant.messages.put_nowait(update(news))
        await asyncio.sleep(0.25)
        assert len(subscriber.texts) == before + 1 and news.keys() <= subscriber.topics()[-1].keys()

    run_feed(scenario)


def test_an_age_grows_while_a_message_waits() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber, later = FakeSubscriber(), FakeSubscriber()
        lease = {"owner": "li", "session": "s", "expires_ms": 9000}
        feed.join(subscriber, DRIVES, 10.0)
        fan = {"lease": lease, "signals": {"f": signal(1.0, source_time_ms=-499)}}
        plant.messages.put_nowait(snapshot(drives__a=fan))
        await asyncio.sleep(1.5)
        feed.join(later, DRIVES, 10.0)
        message = later.messages[0]
        drive = message["topics"]["drives/a"]
        age_ms = message["time_ms"] - drive["signals"]["f"]["source_time_ms"]
        assert (age_ms, drive["lease"]["expires_ms"]) == (2000, 9000)

    run_feed(scenario)


def test_a_plant_that_stops_sending_has_no_heartbeat() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={}))
        for _ in range(3):
            await asyncio.sleep(1.0)
            plant.messages.put_nowait(update())
        await asyncio.sleep(60.0)
        assert subscriber.at == [0.0, 1.0, 2.0, 3.0] and subscriber.topics()[1:] == [{}, {}, {}]

    run_feed(scenario)


def test_a_client_that_comes_while_the_service_is_silent_gets_no_old_value_as_live() -> None:
    """A page whose connection was lost took the snapshot of a service that hung for a live one, again and again."""

    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber, early, late, after = (FakeSubscriber() for _ in range(4))
        feed.join(subscriber, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        await asyncio.sleep(1.9)
        feed.join(early, DRIVES, 0.25)
        await asyncio.sleep(0.2)
        group = feed.join(late, DRIVES, 0.25)
        feed.leave(late, group)
        assert (early.reason, late.reason) == (None, "upstream_lost")
        plant.messages.put_nowait(update())
        await asyncio.sleep(0.1)
        feed.join(after, DRIVES, 0.25)
        await asyncio.sleep(0.1)
        assert after.reason is None and after.topics() == [{"drives/a": {"state": "running"}}]
        assert len(early.topics()) == 2 and late.texts == []

    run_feed(scenario)


def test_a_lost_plant_closes_all_clients_and_the_next_client_gets_no_old_value() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber, next_one = FakeSubscriber(), FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait({"type": "closed", "reason": "shutdown", "text": {}})
        await asyncio.sleep(0.1)
        feed.join(next_one, DRIVES, 0.25)
        await asyncio.sleep(1.0)
        assert (subscriber.reason, next_one.texts) == ("shutdown", [])
        plant.messages.put_nowait(snapshot(drives__b={"state": "stopped"}))
        await asyncio.sleep(0.1)
        assert next_one.topics() == [{"drives/b": {"state": "stopped"}}]

    run_feed(scenario)


def test_a_new_snapshot_of_the_plant_is_a_new_snapshot_for_every_client() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        for name in ("drives__a", "drives__b"):
            plant.messages.put_nowait(snapshot(**{name: {"state": "running"}}))
        await asyncio.sleep(0.1)
        assert [(message["type"], list(message["topics"])) for message in subscriber.messages] == [
            ("snapshot", ["drives/a"]),
            ("snapshot", ["drives/b"]),
        ]

    run_feed(scenario)


def test_a_plant_that_cannot_be_reached_closes_the_client_with_that_reason() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        async def unreachable(*_: Any) -> Any:
            raise ServiceUnavailable("plant.gone")
            yield

        plant.live = unreachable  # type: ignore[method-assign]
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        await asyncio.sleep(0.1)
        assert subscriber.reason == "upstream_lost"

    run_feed(scenario)


def test_removed_topics_and_dropped_items_are_reported() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, ("drives/*", "events"), 0.25)
        plant.messages.put_nowait(snapshot(drives__a={}, events=[]))
        plant.messages.put_nowait(update({"events": [{"id": "1"}]}, removed=["drives/a"], missed={"events": 3}))
        await asyncio.sleep(0.5)
        last = subscriber.messages[-1]
        assert (last["removed"], last["missed"], last["topics"]) == (
            ["drives/a"],
            {"events": 3},
            {"events": [{"id": "1"}]},
        )

    run_feed(scenario)


def test_a_topic_that_was_removed_and_added_again_while_a_message_waited_is_sent() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, DRIVES, 10.0)
        plant.messages.put_nowait(snapshot(drives__a={"state": "running"}))
        plant.messages.put_nowait(update(removed=["drives/a"]))
        plant.messages.put_nowait(update({"drives/a": {"state": "stopped"}}))
        await asyncio.sleep(0.5)
        assert [message["topics"] for message in subscriber.messages][1:] == [{"drives/a": {"state": "stopped"}}]
        assert "removed" not in subscriber.messages[-1]

    run_feed(scenario)


def test_items_beyond_a_messages_limit_drop_the_oldest_and_count_them() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, ("frames/line-1",), 10.0)
        plant.messages.put_nowait(snapshot(**{"buses__line-1": {"is_open": True}}))
        await asyncio.sleep(0.1)
        frames = [{"n": n} for n in range(1, 1001)]
        plant.frames.put_nowait(update({"frames/line-1": frames[:1]}))
        plant.frames.put_nowait(update({"frames/line-1": frames[1:]}))
        await asyncio.sleep(11.0)
        last = subscriber.messages[-1]
        assert (len(last["topics"]["frames/line-1"]), last["topics"]["frames/line-1"][-1]) == (500, {"n": 1000})
        assert last["missed"] == {"frames/line-1": 500}

    run_feed(scenario)


def test_frames_are_subscribed_only_while_a_client_shows_them() -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber, other = FakeSubscriber(), FakeSubscriber()
        feed.join(subscriber, DRIVES, 0.25)
        channel = feed.join(other, ("frames/line-1",), 0.25)
        plant.messages.put_nowait(snapshot(**{"buses__line-1": {"is_open": True}}))
        await asyncio.sleep(0.1)
        assert sorted(plant.subscriptions) == ["frames/line-1", "state"]
        feed.leave(other, channel)
        feed.join(other, ("frames/line-1",), 0.25)
        await asyncio.sleep(0.1)
        assert len(plant.subscriptions) == 3

    run_feed(scenario)


def test_frames_of_an_invented_bus_cost_the_service_nothing_and_those_of_a_new_bus_are_delivered() -> None:
    """A viewer with 15,000 invented names held up the loop of the buses for 4.5 s, and with it every stop."""

    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, tuple(f"frames/line-{number}" for number in range(100)), 0.25)
        plant.messages.put_nowait(snapshot(**{"buses__line-1": {"is_open": True}}))
        await asyncio.sleep(0.1)
        assert sorted(plant.subscriptions) == ["frames/line-1", "state"]
        plant.messages.put_nowait(update({"buses/line-7": {"is_open": True}}))
        await asyncio.sleep(0.1)
        assert sorted(plant.subscriptions) == ["frames/line-1", "frames/line-7", "state"]

    run_feed(scenario)


@pytest.mark.parametrize(
    "pattern, buses", [("frames/*", ["line-1", "line-2"]), ("*", ["line-1", "line-2"]), ("frames/*-2", ["line-2"])]
)
def test_a_star_among_the_frames_stands_for_the_known_buses(pattern: str, buses: list[str]) -> None:
    async def scenario(plant: FakeService, feed: UpstreamFeed) -> None:
        subscriber = FakeSubscriber()
        feed.join(subscriber, (pattern,), 0.25)
        plant.messages.put_nowait(snapshot(**{"buses__line-1": {"is_open": True}, "buses__line-2": {"is_open": True}}))
        await asyncio.sleep(0.1)
        assert sorted(plant.subscriptions) == [*(f"frames/{bus}" for bus in buses), "state"]
        plant.frames.put_nowait(update({"frames/line-2": [{"n": 1}]}))
        await asyncio.sleep(1.0)
        assert any(topics.get("frames/line-2") == [{"n": 1}] for topics in subscriber.topics())

    run_feed(scenario)


def test_a_slow_client_is_closed_with_the_reason_and_delays_no_other() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        slow, quick = FakeWebSocket(reads=False), FakeWebSocket()
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

    run_endpoint(scenario)


def test_a_client_that_disconnects_is_removed() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        task = begin(live, socket)
        await asyncio.sleep(0.1)
        socket.incoming.put_nowait(None)
        await task
        assert (socket.closed, live.open) == (None, 0)
        plant.messages.put_nowait(snapshot(drives__a={}))
        await asyncio.sleep(1.0)
        assert socket.sent == []

    run_endpoint(scenario)


def test_a_subscription_is_changed_while_it_runs() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
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
        assert [list(message["topics"]) for message in socket.sent if message["topics"]] == [["alarms"], ["drives/a"]]
        socket.incoming.put_nowait(None)
        await task

    run_endpoint(scenario)


def test_a_lease_is_renewed_once_for_each_request_in_the_name_of_the_session() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
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
        lease = {"lease": {"owner": "li"}, "ttl_s": 10}
        assert socket.sent[0] == {"type": "leases", "drives": {"fan-1": lease}}
        assert socket.sent[1]["drives"]["fan-1"]["error"]["kind"] == "ControlNotHeld"
        socket.incoming.put_nowait(None)
        await task

    run_endpoint(scenario)


def test_many_leases_are_renewed_by_one_message_and_answered_by_one() -> None:
    drives = [f"{number:03d}{'x' * 61}" for number in range(MAX_RENEWALS)]

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        task = begin(live, socket)
        socket.incoming.put_nowait(json.dumps({"renew": drives}))
        await asyncio.sleep(1.0)
        assert [list(message["drives"]) for message in socket.sent if message["type"] == "leases"] == [drives]
        socket.incoming.put_nowait(json.dumps({"renew": [*drives, "one-more"]}))
        await task
        assert socket.sent[-1]["reason"] == "bad_message"

    run_endpoint(scenario)


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
        '{"renew": ["fan-1"], "renew": ["fan-2"]}',
        "[" * 16_000,
        '{"renew": [' + " " * 20_000 + "]}",
    ],
    ids=lambda text: text[:30],
)
def test_a_malformed_message_ends_the_connection(text: str) -> None:
    with pytest.raises(ValueError):
        parse_message(text)

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        task = begin(live, socket)
        socket.incoming.put_nowait(text)
        await task
        assert (socket.closed, socket.sent[-1]["reason"]) == ((4400, "bad_message"), "bad_message")

    run_endpoint(scenario)


def test_renewals_of_300_drives_are_permitted_and_a_flood_of_them_ends_the_connection() -> None:
    """Each renewal is a request to the service: 2,000 a second of one connection kept its process busy."""

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        page, flood = FakeWebSocket(), FakeWebSocket()
        tasks = [begin(live, page), begin(live, flood)]
        for _ in range(40):
            for count in (200, 100):
                page.incoming.put_nowait(json.dumps({"renew": ["fan-1"] * count}))
            for _ in range(6):
                flood.incoming.put_nowait(json.dumps({"renew": ["fan-1"] * 200}))
            await asyncio.sleep(3.0)
        assert (page.closed, flood.closed) == (None, (4029, "rate_limited"))
        page.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    run_endpoint(scenario)


@pytest.mark.parametrize("alphabet", ["a*", "ab*"])
def test_a_star_stands_for_any_characters(alphabet: str) -> None:
    """Compared with the standard library, which compiles each pattern that a client invents."""
    for length in range(6):
        for letters in itertools.product(alphabet, repeat=length):
            pattern = "".join(letters)
            for topic in ("", "a", "b", "ab", "ba", "aab", "abab", "aaaa"):
                assert matches_topic(topic, pattern) is fnmatchcase(topic, pattern), (topic, pattern)


def test_subscriptions_of_many_clients_leave_turns_of_the_loop_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of one viewer with 40 connections, all handled in one turn, delayed a stop over the page by 20 s."""

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        turn, turns = 0, []
        join = UpstreamFeed.join

        def note_turn(feed: UpstreamFeed, *arguments: Any) -> Any:
            turns.append(turn)
            return join(feed, *arguments)

        sockets = [FakeWebSocket() for _ in range(20)]
        tasks = [begin(live, socket) for socket in sockets]
        await asyncio.sleep(1)
        monkeypatch.setattr(UpstreamFeed, "join", note_turn)
        for socket in sockets:
            socket.incoming.put_nowait('{"subscribe": ["drives/*a*"]}')
        for turn in range(200):  # noqa: B007  note_turn reads it
            await asyncio.sleep(0)
        assert len(turns) == len(set(turns)) == len(sockets)
        for socket in sockets:
            socket.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    run_endpoint(scenario)


def test_a_message_with_many_topics_counts_as_several() -> None:
    assert parse_message('{"subscribe": ["plant"]}').cost == 1.0
    topics = [f"drives/{number}" for number in range(100)]
    assert parse_message(json.dumps({"subscribe": topics})).cost == 5.0


def test_too_many_messages_end_the_connection() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
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

    run_endpoint(scenario)


def test_websockets_beyond_the_limit_are_refused() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        sockets = [FakeWebSocket(remote_actor(f"user-{number}")) for number in range(MAX_WEBSOCKETS + 1)]
        tasks = [begin(live, socket) for socket in sockets]
        await asyncio.sleep(0.1)
        assert [socket.closed for socket in sockets] == [None] * MAX_WEBSOCKETS + [(1013, "many")]
        assert (sockets[-1].sent[-1]["type"], sockets[-1].sent[-1]["reason"]) == ("closed", "many")
        for socket in sockets:
            socket.incoming.put_nowait(None)
        await asyncio.gather(*tasks)

    run_endpoint(scenario)


def test_one_user_leaves_websockets_to_the_others() -> None:
    """A viewer could open all of them, with sessions and tokens: no operator saw a value any more."""

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        viewer, program = (remote_actor(name, Role.VIEWER) for name in ("eve", "eve/report"))
        sockets = [FakeWebSocket((viewer, program)[number % 2]) for number in range(MAX_WEBSOCKETS // 2 + 1)]
        operator = FakeWebSocket(remote_actor("bob"))
        tasks = [begin(live, socket) for socket in (*sockets, operator)]
        await asyncio.sleep(0.1)
        assert [socket.closed for socket in sockets] == [None] * (MAX_WEBSOCKETS // 2) + [(1013, "many")]
        assert operator.closed is None
        sockets[0].incoming.put_nowait(None)
        await asyncio.sleep(0.1)
        again = FakeWebSocket(viewer)
        tasks.append(begin(live, again))
        await asyncio.sleep(0.1)
        assert again.closed is None
        for socket in (*sockets[1:], operator, again):
            socket.incoming.put_nowait(None)
        await asyncio.gather(*tasks)
        assert live.open == 0

    run_endpoint(scenario)


def test_two_users_together_leave_websockets_to_the_others() -> None:
    """Each could open half of them: two viewers, or one with two accounts, had them all."""

    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        flood = [FakeWebSocket(remote_actor(name, Role.VIEWER)) for name in ("eve", "mallory") * MAX_WEBSOCKETS]
        operator = FakeWebSocket(remote_actor("bob"))
        tasks = [begin(live, socket) for socket in (*flood, operator)]
        await asyncio.sleep(0.1)
        assert operator.closed is None
        for socket in (*flood, operator):
            socket.incoming.put_nowait(None)
        await asyncio.gather(*tasks)
        assert live.open == 0

    run_endpoint(scenario)


@pytest.mark.parametrize("query", [{"interval": "0.05"}, {"interval": "11"}, {"interval": "nan"}, {"topics": "x"}])
def test_a_connection_with_invalid_parameters_is_closed_at_once(query: dict[str, str]) -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        socket.query_params = query
        await live.serve(cast(WebSocket, socket))
        assert (socket.closed, plant.subscriptions) == ((4400, "bad_message"), [])
        assert [(message["type"], message["reason"]) for message in socket.sent] == [("closed", "bad_message")], (
            "the last message"
        )

    run_endpoint(scenario)


def test_a_fast_client_shares_the_subscription_of_the_others() -> None:
    async def scenario(plant: FakeService, live: LiveEndpoint) -> None:
        socket = FakeWebSocket()
        socket.query_params = {"interval": "0.1"}
        task = begin(live, socket)
        await asyncio.sleep(0.1)
        assert plant.subscriptions == ["state"]
        socket.incoming.put_nowait(None)
        await task

    run_endpoint(scenario)


def test_equivalent_patterns_and_intervals_are_normalized() -> None:
    assert parse_patterns(["plant", "alarms", "plant"]) == ("alarms", "plant")


def test_an_address_has_as_many_patterns_as_a_message() -> None:
    """An address of 8 kB could have 800: each is searched for in every topic."""
    patterns = [f"drives/*{number}" for number in range(MAX_PATTERNS)]
    assert len(parse_patterns(patterns)) == MAX_PATTERNS
    with pytest.raises(ValueError, match="a list"):
        parse_patterns([*patterns, "plant"])
    assert [parse_interval(text) for text in (None, "1", "0.26", "0.1")] == [0.25, 1.0, 0.25, 0.1]
    assert parse_message(json.dumps({"subscribe": ["*"], "renew": ["a"]})).renew == ("a",)
