"""Dispatcher: rights, state of the service, and the audit record of every operation."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.outcome import FrameExchange, Outcome, OutcomeStatus
from drivebus.errors import (
    AuditUnavailable,
    DrivebusError,
    Expired,
    InvalidParameters,
    NotFound,
    PermissionDenied,
    ServiceUnavailable,
    StartInhibited,
    StopUnconfirmed,
    TooManyCommands,
)
from drivebus.service.api.audit_aggregator import SUMMARY_PERIOD_S
from drivebus.service.api.dispatcher import MAX_RECORDING_S, STOP_AUDIT_TIMEOUT_S, Dispatcher
from drivebus.service.api.errors import param_fault
from drivebus.service.api.operations import OPERATIONS, Audit
from drivebus.service.api.record_budget import RECORD_OCTETS_PER_S
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.records import SESSION_ENDED, record_octets
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right, Role
from drivebus.service.config.model import GroupConfig
from drivebus.simulator.motor import OutputPhase
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import LOCAL, ServiceKit, plant_config, ready, remote_actor, running_service

NO_RIGHTS = Actor("eve", frozenset(), "s-eve", address="10.0.0.9")
FAN = {"drive": "fan-1"}


def with_dispatcher(scenario: Callable[[ServiceKit, Dispatcher], Awaitable[None]], **answers: Any) -> None:
    """Run a scenario with a dispatcher of fake handlers.

    ``answers``: result or exception of each operation, ``drive_stop`` for ``drive.stop``.
    """

    async def handler(name: str, *_: Any) -> Json:
        found = answers[name]
        if isinstance(found, BaseException):
            raise found
        return dict(found)

    def handlers(names: Iterable[str]) -> dict[str, Any]:
        return {name.replace("_", ".", 1): lambda *arguments, name=name: handler(name, *arguments) for name in names}

    async def in_service() -> None:
        async with running_service() as kit:
            await scenario(kit, Dispatcher(kit.service.plant, handlers(answers)))

    run(in_service())


@pytest.mark.parametrize("name", ["nothing.at_all", "drives.list"])
def test_an_unknown_operation_or_one_without_handler_is_not_found(name: str) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        with pytest.raises(NotFound) as rejected:
            await dispatcher.call(name, {}, LOCAL)
        assert (rejected.value.key, rejected.value.params) == ("plant.no_operation", {"id": name})

    with_dispatcher(scenario)


@pytest.mark.parametrize(
    ("name", "params", "target"),
    [
        ("drive.stop", FAN, "fan-1"),
        ("group.stop", {"group": "fans"}, "fans"),
        ("buses.get", {"bus": "a"}, "a"),
        ("alarm.acknowledge", {"alarm": "7"}, "7"),
        ("plant.stop", {}, ""),
        ("drive.stop", {"drive": 7}, ""),
        ("drive.stop", {"drive": "fan-1", "group": "fans"}, "fan-1"),
    ],
)
def test_a_denied_operation_is_recorded_with_its_target(name: str, params: Json, target: str) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        right = str(OPERATIONS[name].right)
        with pytest.raises(PermissionDenied) as rejected:
            await dispatcher.call(name, params, NO_RIGHTS)
        assert rejected.value.key == "plant.forbidden"
        assert rejected.value.params == {"name": "eve", "operation": name, "right": right}
        assert kit.trail.entries == [
            AuditEntry(
                what=name,
                who="eve",
                session="s-eve",
                address="10.0.0.9",
                target=target,
                params=params,
                outcome="plant.forbidden",
            ),
        ]

    with_dispatcher(scenario)


def test_a_flood_of_denied_operations_leaves_one_record_and_a_count() -> None:
    """A viewer with one WebSocket could write 1,600 records a second: renewals of control that it may not have."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        for number in range(500):
            with pytest.raises(PermissionDenied):
                await dispatcher.call("lease.renew", {"drive": f"fan-{number}"}, NO_RIGHTS)
        assert [(entry.what, entry.target) for entry in kit.trail.entries] == [("lease.renew", "fan-0")]
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        assert [entry.what for entry in kit.trail.entries] == ["lease.renew", "refused"]
        assert kit.trail.entries[-1].params == {"who": "eve@10.0.0.9", "times": 499}

    with_dispatcher(scenario)


def test_the_record_of_a_denied_request_with_many_parameters_has_its_target_only() -> None:
    """A viewer could write 60 KB of unchecked parameters into the trail with each kind of request."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        params = FAN | {"values": {f"F1.{number}": "x" * 500 for number in range(100)}}
        for found in (params, {"drive": "x" * 1_900}):
            with pytest.raises(PermissionDenied):
                await dispatcher.call("parameters.write", found, remote_actor(str(len(found)), Role.VIEWER))
        first, second = kit.trail.entries
        assert (first.target, first.params, first.outcome) == ("fan-1", {}, "plant.forbidden")
        assert (second.target, second.params) == ("x" * 100, {})

    with_dispatcher(scenario)


@pytest.fixture
def small_burst(monkeypatch: pytest.MonkeyPatch) -> None:
    """A flood uses up the budget within a minute."""
    monkeypatch.setattr("drivebus.service.api.record_budget.MAX_BURST_OCTETS", 100_000)


async def octets_per_second(kit: ServiceKit) -> float:
    """Return the growth of the trail during 200 s of a flood, after its first minute, in octets a second."""
    await asyncio.sleep(60.0)
    before = len(kit.trail.entries)
    await asyncio.sleep(200.0)
    return sum(map(record_octets, kit.trail.entries[before:])) / 200.0


@pytest.mark.usefixtures("small_burst")
@pytest.mark.parametrize("name", ["drive.run", "lease.take"])
def test_a_flood_of_commands_that_send_nothing_is_recorded_one_by_one_up_to_a_budget_and_then_counted(
    name: str,
) -> None:
    """A user with the right to operate wrote 1.7 MB a second into the audit trail: the disk was its only limit."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        params = FAN | ({"frequency_hz": 20.0} if name == "drive.run" else {})
        answers = {"refused": 0, "too many": 0}

        async def flood() -> None:
            while True:
                try:
                    await dispatcher.call(name, params, remote_actor("eve"))
                except TooManyCommands as error:
                    answers["too many"] += 1
                    assert (error.key, error.params["name"]) == ("plant.too_many_commands", "eve")
                    assert 0.1 <= error.params["retry_s"] < 1
                except StartInhibited:
                    answers["refused"] += 1
                await asyncio.sleep(0.05)

        flooding = asyncio.create_task(flood())
        assert 0.7 < await octets_per_second(kit) / RECORD_OCTETS_PER_S < 1.05
        with pytest.raises(StartInhibited):
            await dispatcher.call("drive.run", FAN | {"frequency_hz": 20.0}, remote_actor("ann"))
        assert await dispatcher.call("drive.stop", FAN, remote_actor("eve")) == {}, "a stop is sent"
        flooding.cancel()
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        counts = [entry.params["times"] for entry in kit.trail.entries if entry.what == "refused"]
        singly = [
            entry for entry in kit.trail.entries if entry.outcome == "plant.too_many_commands" and entry.what == name
        ]
        assert sum(counts) + len(singly) == answers["too many"], "none of them is lost"
        assert answers["too many"] > 3_000

    with_dispatcher(
        scenario, drive_run=StartInhibited("plant.limits_lost", drive="fan-1"), lease_take={}, drive_stop={}
    )


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("lease.release", FAN),
        ("waiver.revoke", {"drive": "fan-1"}),
        ("alarm.acknowledge", {"alarm": "7"}),
        ("alarms.acknowledge", {"alarms": ["7"]}),
    ],
)
def test_a_command_that_reduces_a_hazard_is_counted_and_not_refused_beyond_the_budget(name: str, params: Json) -> None:
    """A user whose program was refused again and again could not give up control or acknowledge an alarm."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        ann = remote_actor("ann", Role.ADMINISTRATOR)
        dispatcher._command_budget.spend(ann, 10_000_000, kit.service.plant.now())
        with pytest.raises(TooManyCommands):
            await dispatcher.call("drive.set_frequency", FAN | {"frequency_hz": 5.0}, ann)
        for _ in range(4):
            assert await dispatcher.call(name, params, ann) == {"done": True}
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        recorded = [(entry.outcome, entry.params.get("times")) for entry in kit.trail.entries if entry.what == name]
        assert recorded == [("requested", None), ("counted", 3)]

    answers = {name.replace(".", "_", 1): {"done": True}}
    with_dispatcher(scenario, drive_set_frequency={}, **answers)


@pytest.mark.usefixtures("small_burst")
def test_commands_that_were_sent_and_those_of_the_local_user_use_up_no_budget() -> None:
    """A bus limits the former; the user of the service can remove the trail."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        for actor, name in ((remote_actor("eve"), "drive.reset"), (LOCAL, "lease.release")):
            for _ in range(1_000):
                await dispatcher.call(name, FAN, actor)
        assert len(kit.trail.entries) == 4_000

    sent = {"outcome": {"status": "confirmed", "frames": [{"sent": "01"}]}}
    with_dispatcher(scenario, drive_reset=sent, lease_release={})


@pytest.mark.usefixtures("small_burst")
def test_a_flood_of_stops_is_sent_at_once_and_recorded_as_a_count_beyond_a_budget() -> None:
    """A right to stop was enough to fill the disk."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        eve, sent = remote_actor("eve"), 0

        async def flood() -> None:
            nonlocal sent
            while True:
                begun = kit.service.plant.now()
                await dispatcher.call("drive.stop", FAN, eve)
                assert kit.service.plant.now() == begun
                sent += 1
                await asyncio.sleep(0.05)

        flooding = asyncio.create_task(flood())
        assert 0.7 < await octets_per_second(kit) / RECORD_OCTETS_PER_S < 1.05
        flooding.cancel()
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        counted = [entry for entry in kit.trail.entries if entry.outcome == "counted"]
        assert {(entry.what, entry.target, entry.params["who"]) for entry in counted} == {
            ("drive.stop", "fan-1", "eve@127.0.0.1")
        }
        singly = kit.trail.outcomes("drive.stop").count("requested")
        assert sum(entry.params["times"] for entry in counted) + singly == sent, "none of them is lost"

    with_dispatcher(scenario, drive_stop={"outcome": {"status": "confirmed", "frames": [{"sent": "01"}]}})


def test_the_size_of_a_local_users_records_is_not_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """No budget limits them, and encoding the record of a stop of many drives delays the buses."""
    monkeypatch.delattr("drivebus.service.api.record_budget.record_octets")

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        assert await dispatcher.call("drive.stop", FAN, LOCAL) == {}
        with pytest.raises(NameError):
            await dispatcher.call("drive.stop", FAN, remote_actor("ann"))

    with_dispatcher(scenario, drive_stop={})


@pytest.mark.usefixtures("small_burst")
def test_stops_beyond_the_budget_are_on_the_bus_at_once_and_stop_the_motor() -> None:
    """A flood of stops was tested with a handler that sends nothing."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(5.0)
            eve, station, plant = remote_actor("eve"), kit.station("fan-1"), kit.service.plant
            kit.service.dispatcher._stop_budget.spend(eve, 1_000_000, plant.now())
            assert station.motor.phase is not OutputPhase.OFF
            kit.trail.entries.clear()
            begun_at = plant.now()
            outcome = (await kit.call("drive.stop", eve, drive="fan-1"))["outcome"]
            assert outcome["status"] == "confirmed" and outcome["frames"]
            assert plant.now() - begun_at < 3.0
            assert station.motor.phase is OutputPhase.OFF
            for _ in range(5):
                assert (await kit.call("drive.stop", eve, drive="fan-1"))["outcome"]["frames"], "each is sent"
            await asyncio.sleep(SUMMARY_PERIOD_S + 1)
            stops = [entry for entry in kit.trail.entries if (entry.what, entry.target) == ("drive.stop", "fan-1")]
            assert [(entry.outcome, entry.params.get("times")) for entry in stops] == [
                ("requested", None),
                ("counted", 5),
            ]

    run(scenario())


@pytest.mark.usefixtures("small_burst")
@pytest.mark.parametrize("hidden_by", ["invented drives", "refused requests"])
def test_the_author_of_counted_stops_is_recorded_however_many_kinds_were_counted_before(hidden_by: str) -> None:
    """Stops of 16 invented drives used up the kinds of a period: "* times 5" was left of those of a real one."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        eve, ann = remote_actor("eve"), remote_actor("ann", Role.VIEWER)
        dispatcher._stop_budget.spend(eve, 1_000_000, kit.service.plant.now())
        if hidden_by == "invented drives":
            for number in range(20):
                await dispatcher.call("drive.stop", {"drive": f"no-{number}"}, eve)
                await asyncio.sleep(0)
        else:
            for name in [operation.name for operation in OPERATIONS.values() if operation.right is Right.OPERATE][:20]:
                with pytest.raises(PermissionDenied):
                    await dispatcher.call(name, {}, ann)
        for _ in range(5):
            await dispatcher.call("drive.stop", FAN, eve)
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        stops = [entry for entry in kit.trail.entries if entry.what == "drive.stop" and entry.outcome == "counted"]
        assert sum(entry.params["times"] for entry in stops if entry.params["who"].startswith("eve")) >= 4
        assert {entry.target for entry in stops} <= {"fan-1", "*"}
        unknown = [entry.outcome for entry in kit.trail.entries if entry.target.startswith("no-")]
        assert unknown == (["plant.no_drive"] if hidden_by == "invented drives" else [])

    with_dispatcher(scenario, drive_stop={"outcome": {"status": "confirmed", "frames": [{"sent": "01"}]}})


def test_live_values_need_the_right_to_view() -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        dispatcher.check_may_view(Actor("ann", frozenset({Right.VIEW}), "s-ann"))
        with pytest.raises(PermissionDenied) as rejected:
            dispatcher.check_may_view(Actor("eve", frozenset(Right) - {Right.VIEW}, "s-eve"))
        assert rejected.value.key == "plant.forbidden"
        assert rejected.value.params == {"name": "eve", "operation": "live", "right": "view"}

    with_dispatcher(scenario)


@pytest.mark.parametrize("state", ["running", "stopping", "ended"])
@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("drive.run", FAN | {"frequency_hz": 20.0}),
        ("waiver.grant", FAN | {"reason": "because"}),
        ("drive.stop", FAN),
        ("drives.list", {}),
    ],
)
def test_a_stopping_service_accepts_stops_and_queries_and_an_ended_one_nothing(
    state: str, name: str, params: Json
) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        kit.service.plant.state = state
        try:
            if state == "running" or (state == "stopping" and name in ("drive.stop", "drives.list")):
                assert await dispatcher.call(name, params, LOCAL) == {}
                return
            with pytest.raises(ServiceUnavailable) as rejected:
                await dispatcher.call(name, params, LOCAL)
            assert rejected.value.key == "plant.stopping" and kit.trail.entries == []
        finally:
            kit.service.plant.state = "running"

    with_dispatcher(scenario, drive_run={}, waiver_grant={}, drive_stop={}, drives_list={})


def test_faults_found_by_a_handler_have_the_same_shape() -> None:
    wrong = [param_fault("names.0", "x", "unknown")]

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        with pytest.raises(InvalidParameters) as rejected:
            await dispatcher.call("parameters.read", FAN | {"names": ["x"]}, LOCAL)
        assert rejected.value.key == "plant.params" and rejected.value.params["operation"] == "parameters.read"
        assert rejected.value.params["faults"] == wrong
        for language in i18n.LANGUAGES:
            sentence = rejected.value.text(language)
            start = {"en": "names.0: ", "zh": "names.0："}[language]
            assert sentence.startswith(start) and "parameters.read" not in sentence, "no id of an operation"

    with_dispatcher(scenario, parameters_read=InvalidParameters("plant.params", faults=wrong))


# --- audit records ----------------------------------------------------------------------------------------------------


def test_the_time_limits_have_not_changed() -> None:
    assert (MAX_RECORDING_S, STOP_AUDIT_TIMEOUT_S) == (2.0, 1.0)


def test_starts_and_wider_permissions_require_an_audit_record() -> None:
    assert {operation.name for operation in OPERATIONS.values() if operation.audit is Audit.REQUIRED} == {
        "drive.arm",
        "drive.run",
        "drive.jog",
        "group.arm",
        "group.start",
        "parameters.write",
        "waiver.grant",
        "waivers.grant",
        "waiver.revoke",
        "comm_loss.test",
        "comm_loss.discard",
        "drive.limits",
        "configuration.reload",
    }


@pytest.mark.parametrize("name", ["drive.reset", "waiver.grant"])
def test_a_command_that_cannot_be_recorded_is_not_executed(name: str) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        kit.trail.fails_silently = True
        params = FAN | ({"reason": "because"} if name == "waiver.grant" else {})
        if OPERATIONS[name].audit is Audit.BEST_EFFORT:
            assert await dispatcher.call(name, params, LOCAL) == {}
            (ended,) = kit.trail.entries
            assert (ended.what, ended.outcome, ended.of) == (name, "done", None)
            return
        with pytest.raises(AuditUnavailable):
            await dispatcher.call(name, params, LOCAL)
        what = {"what": "waiver.grant"}
        assert kit.trail.entries == [
            AuditEntry(
                what="audit.refused", who="tester", session="local-1", address="local", target="fan-1", params=what
            )
        ]
        (alarm,) = kit.service.plant.alarms.active()
        assert (alarm.kind, alarm.subject) == ("audit_failure", "audit.jsonl")

    with_dispatcher(scenario, drive_reset={}, waiver_grant={})


def test_the_storage_alarm_is_cleared_by_the_next_written_record() -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        kit.trail.fails_silently = True
        await dispatcher.call("drive.reset", FAN, LOCAL)
        kit.trail.fails_silently = False
        await dispatcher.call("drive.reset", FAN, LOCAL)
        (alarm,) = kit.service.plant.alarms.active()
        assert (alarm.kind, alarm.subject, alarm.cleared_ms is None) == ("audit_failure", "audit.jsonl", False)

    with_dispatcher(scenario, drive_reset={})


def test_an_event_that_is_no_operation_is_recorded_with_its_actor() -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        event = {"what": "login", "target": "ann", "params": {"how": "x"}, "outcome": "done", "who": "another"}
        await dispatcher.record(event, NO_RIGHTS)
        assert kit.trail.entries == [
            AuditEntry(
                what="login",
                who="eve",
                session="s-eve",
                address="10.0.0.9",
                target="ann",
                params={"how": "x"},
                outcome="done",
            )
        ]

    with_dispatcher(scenario)


def test_what_has_happened_is_recorded_later_where_the_trail_fails_and_only_a_request_as_refused() -> None:
    """A logout, or the end of control of a disabled user, was in the trail as refused, without its drives."""

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        ann = remote_actor()
        await kit.call("lease.take", ann, drive="fan-1")
        kit.trail.entries.clear()
        kit.trail.fails_silently = True
        for event in ({"what": "user.change", "outcome": "requested"}, {"what": "logout", "outcome": "done"}):
            with pytest.raises(AuditUnavailable):
                await dispatcher.record(event, NO_RIGHTS)
        with pytest.raises(AuditUnavailable):
            await kit.service.end_control("rights", ann)
        entries = kit.trail.entries
        assert [(entry.what, entry.outcome) for entry in entries] == [
            ("audit.refused", None),
            ("logout", "done"),
            (SESSION_ENDED, "done"),
        ]
        assert entries[0].params == {"what": "user.change"} and entries[2].params["drives"] == ["fan-1"]

    with_dispatcher(scenario)


@pytest.mark.parametrize(("takes_s", "done"), [(MAX_RECORDING_S, True), (MAX_RECORDING_S + 0.014, False)])
def test_a_command_expires_while_its_record_is_written(takes_s: float, done: bool) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        kit.trail.delay_s = takes_s
        if done:
            await dispatcher.call("drive.set_frequency", FAN | {"frequency_hz": 20.0}, LOCAL)
            return
        with pytest.raises(Expired) as rejected:
            await dispatcher.call("drive.set_frequency", FAN | {"frequency_hz": 20.0}, LOCAL)
        assert rejected.value.key == "plant.record_too_slow"
        assert rejected.value.params == {"age_s": 2.01, "limit_s": 2.0}
        assert kit.trail.outcomes("drive.set_frequency") == ["requested", "plant.record_too_slow"]

    with_dispatcher(scenario, drive_set_frequency={})


@pytest.mark.parametrize(
    ("name", "followers"), [("drive.run", ["fan-2"]), ("drive.set_frequency", ["fan-2"]), ("drive.jog", [])]
)
def test_the_record_of_a_new_frequency_names_the_followers(name: str, followers: list[str]) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        fans = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1")
        kit.service.plant.config = plant_config(groups=(fans,))
        kit.service.plant.drives["fan-2"].started_by_service = True
        await dispatcher.call(name, FAN | {"frequency_hz": 20.0}, LOCAL)
        kit.service.plant.drives["fan-2"].started_by_service = False
        assert kit.trail.entries[0].params.get("drives", []) == followers

    with_dispatcher(scenario, drive_run={}, drive_set_frequency={}, drive_jog={})


@pytest.mark.parametrize("takes_s", [0.25, 3.0])
def test_a_stop_waits_at_most_a_second_for_its_record(takes_s: float) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        kit.trail.delay_s = takes_s
        started_at = asyncio.get_running_loop().time()
        await dispatcher.call("drive.stop", FAN, LOCAL)
        waited_s = asyncio.get_running_loop().time() - started_at
        assert waited_s == pytest.approx(min(2 * takes_s, STOP_AUDIT_TIMEOUT_S)), "its request and its outcome"
        await asyncio.sleep(2 * takes_s)
        assert kit.trail.outcomes("drive.stop") == ["requested", "confirmed"]

    with_dispatcher(scenario, drive_stop={"outcome": {"status": "confirmed"}})


def test_a_stop_is_in_the_trail_before_it_is_confirmed_and_its_frames_wait_for_no_record() -> None:
    """A service that was killed during a stop left no record of it."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            stop = asyncio.create_task(kit.call("drive.stop", drive="fan-1"))
            await asyncio.sleep(0.05)
            assert kit.trail.outcomes("drive.stop") == ["requested"] and not stop.done()
            number = len(kit.trail.entries)
            await stop
            assert kit.trail.outcomes("drive.stop") == ["requested", "confirmed"]
            assert kit.trail.entries[-1].of == number
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            kit.trail.delay_s = 60.0
            await asyncio.wait_for(kit.call("drive.stop", drive="fan-1"), 5.0)
            assert kit.station("fan-1").motor.phase is OutputPhase.OFF
            assert kit.trail.outcomes("drive.stop") == ["requested", "confirmed"], "a disk that hangs"

    run(scenario())


DONE: list[tuple[Json, str, list[str]]] = [
    ({}, "done", []),
    ({"outcome": {"status": "confirmed", "frames": ["a"]}}, "confirmed", ["a"]),
    ({"outcome": {"frames": ["a"]}}, "done", ["a"]),
    (
        {
            "outcome": {"status": "confirmed", "frames": ["a", "b"]},
            "followers": {"fan-2": {"code": "plant.not_owner"}, "fan-3": {"status": "confirmed", "frames": ["c"]}},
        },
        "confirmed, plant.not_owner",
        ["a", "b", "c"],
    ),
    ({"outcomes": {"fan-1": {"status": "acknowledged", "frames": ["d"]}}}, "acknowledged", ["d"]),
]


@pytest.mark.parametrize(("found", "outcome", "frames"), DONE, ids=range(len(DONE)))
@pytest.mark.parametrize("name", ["drive.reset", "drive.stop"])
def test_the_record_of_a_command_has_every_status_and_every_frame(
    name: str, found: Json, outcome: str, frames: list[str]
) -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        await dispatcher.call(name, FAN, LOCAL)
        ended = kit.trail.entries[-1]
        assert (ended.what, ended.outcome, list(ended.frames)) == (name, outcome, frames)
        assert ended.of == 1

    with_dispatcher(scenario, drive_reset=found, drive_stop=found)


@pytest.mark.parametrize("name", ["drive.reset", "drive.stop"])
@pytest.mark.parametrize("sent", [True, False])
def test_the_record_of_a_failure_has_its_key_and_the_sent_frames(name: str, sent: bool) -> None:
    state = {"state": "running"}
    error: DrivebusError = (
        StopUnconfirmed("drives.stop_unconfirmed", **state) if sent else StartInhibited("plant.stopping")
    )
    if sent:
        frame = FrameExchange(sent=b"\x01", received=b"", sent_at=1.0, received_at=None)
        error.outcome = Outcome(
            status=OutcomeStatus.UNKNOWN, key="drives.stop_unconfirmed", params=state, exchanges=(frame,)
        )

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        with pytest.raises(DrivebusError):
            await dispatcher.call(name, FAN, LOCAL)
        ended = kit.trail.entries[-1]
        assert (ended.outcome, [frame["sent"] for frame in ended.frames]) == (error.key, ["01"] if sent else [])

    with_dispatcher(scenario, drive_reset=error, drive_stop=error)


def test_a_write_to_eeprom_needs_the_right_save_as_well() -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        values = FAN | {"values": {"F0.1": 2.0}}
        for rights, save, may in (
            ({Right.WRITE_PARAMETERS}, False, True),
            ({Right.WRITE_PARAMETERS}, True, False),
            ({Right.SAVE}, True, False),
            ({Right.SAVE, Right.WRITE_PARAMETERS}, True, True),
        ):
            tuner = Actor("tom", frozenset(rights), "s-tom")
            if may:
                await dispatcher.call("parameters.write", values | {"save": save}, tuner)
                continue
            with pytest.raises(PermissionDenied):
                await dispatcher.call("parameters.write", values | {"save": save}, tuner)

    with_dispatcher(scenario, parameters_write={})


def test_an_operator_may_not_grant_a_waiver() -> None:
    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        with pytest.raises(PermissionDenied):
            await dispatcher.call("waiver.grant", FAN | {"reason": "because"}, remote_actor())

    with_dispatcher(scenario, waiver_grant={})


@pytest.mark.parametrize("name", ["drives.get", "drives.profile", "drives.statistics"])
def test_a_query_about_an_unknown_drive_is_not_found(name: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            with pytest.raises(NotFound):
                await kit.service.call(name, {"drive": "nobody"}, LOCAL)

    run(scenario())


def test_the_record_of_a_command_to_several_drives_has_the_status_of_each() -> None:
    """Regression: "not done (plant.not_owner)" did not say which drive."""
    refused = {"code": "plant.not_owner"}
    outcomes = {"fan-1": {"status": "unchanged"}, "fan-2": refused, "fan-3": {"outcome": None}}

    async def scenario(kit: ServiceKit, dispatcher: Dispatcher) -> None:
        await dispatcher.call("waivers.grant", {"drives": ["fan-1"], "reason": "hard-wired stop"}, LOCAL)
        assert kit.trail.entries[-1].params["outcomes"] == {
            "fan-1": "unchanged",
            "fan-2": "plant.not_owner",
            "fan-3": "done",
        }
        await dispatcher.call("drive.reset", FAN, LOCAL)
        assert "outcomes" not in kit.trail.entries[-1].params

    with_dispatcher(scenario, waivers_grant={"outcomes": outcomes}, drive_reset={})
