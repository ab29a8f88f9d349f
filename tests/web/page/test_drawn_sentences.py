"""Sentences of the page about a drive or a bus: each part is drawn alone, in the case of the sentence and beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.permissives import RUN_STATES
from drivebus.drives.state import DriveState
from drivebus.service.alarms import SystemAlarm
from drivebus.service.alarms.engine import system_alarm
from drivebus.values import Text
from fixtures.browser import Stage

Draw = Callable[..., str]
DRAW = """async ([module, part, props, { connection, closed, lost_ms, topics, stops, takeovers, only }]) => {
  const load = (name) => import(`/static/js/${name}.js`);
  const names = ["lib", "i18n", "live", "session", "control/stops", "store", "control/takeovers"];
  const [lib, i18n, live, session, stopList, store, taken] = await Promise.all(names.map(load));
  if (!i18n.hasKey("page.blocked")) await i18n.loadLanguage("en");
  const rights = ["view", "stop", "operate", "limit"];
  session.session.value = { user: "me", session: "mine", idle: false, rights };
  live.connection.value = connection ?? "live";
  live.closedText.value = closed ?? null;
  live.lostAt.value = live.now.value + (lost_ms ?? 0);
  taken.takeovers.value = takeovers ?? [];
  stopList.stops.value = (stops ?? []).map((one) => ({ ...one, text: () => one.why }));
  store.applySnapshot({ time_ms: 0, topics: topics ?? {} });
  await new Promise((resolve) => { requestAnimationFrame(() => setTimeout(resolve)); });
  const root = document.body.appendChild(document.createElement("div"));
  lib.render(lib.h((await load(module))[part], props), root);
  const text = (only ? [...root.querySelectorAll(only)] : [root]).map((one) => one.textContent).join(" ");
  lib.render(null, root);
  root.remove();
  return text.replace(/\\s+/g, " ").trim();
}"""


@pytest.fixture(scope="module")
def blank(browser: Any, plant: Stage) -> Iterator[Any]:
    """Open a document of the page's origin on which no script runs: nothing but the test changes its state."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{plant.at}/static/js/lib.js")
    yield page
    context.close()


@pytest.fixture
def draw(blank: Any) -> Draw:
    """Return a function that draws one part of the page and returns its text."""

    def text_of(module: str, part: str, props: Any, **state: Any) -> str:
        return str(blank.evaluate(DRAW, [module, part, props, state]))

    return text_of


@pytest.fixture(scope="module")
def fan(plant: Stage) -> Any:
    """Return the view of a stopped drive without a control lease."""
    return plant.view("fan-1") | {"lease": None, "last_stop": None, "start_blockers": [], "control_request": None}


def shown(text: str, keys: Iterable[str], **params: Any) -> list[str]:
    """Return those of the keys whose sentence is in a text."""
    return [key for key in keys if i18n.text(key, "en", **params).rstrip(" ,") in text]


CONTROL = ("page.lease_free", "page.lease_mine", "page.lease_other_window", "page.not_live", "page.not_online")
ONLINE_AND_STOPPED = {"presence": "online", "state": "stopped", "fault": None}
MINE = {"owner": "me", "session": "mine", "remote": True}
OTHER_WINDOW = MINE | {"session": "another"}
OTHER_USER = OTHER_WINDOW | {"owner": "bob"}
NAMESAKE = OTHER_WINDOW | {"remote": False}


@pytest.mark.parametrize(
    ("changed", "connection", "expected"),
    [
        ({}, "live", ["page.lease_free"]),
        ({"lease": MINE}, "live", ["page.lease_mine"]),
        ({"lease": OTHER_WINDOW}, "live", ["page.lease_other_window"]),
        ({"lease": MINE}, "lost", ["page.lease_mine", "page.not_live"]),
        ({"lease": MINE, "presence": "offline"}, "live", ["page.lease_mine", "page.not_online"]),
    ],
)
def test_who_controls_a_drive_and_why_only_stops_are_possible(
    draw: Draw, fan: Any, changed: Any, connection: str, expected: list[str]
) -> None:
    text = draw("drive/control", "ControlPanel", {"view": fan | changed}, connection=connection)
    assert shown(text, CONTROL) == expected


PRESENCES = ("page.presence_unusable", "page.presence_offline", "page.presence_never_seen")


@pytest.mark.parametrize(
    ("presence", "unusable", "expected"),
    [
        ("offline", True, PRESENCES[0]),
        ("never_seen", True, PRESENCES[0]),
        ("offline", False, PRESENCES[1]),
        ("never_seen", False, PRESENCES[2]),
    ],
)
def test_a_drive_that_sends_bytes_in_place_of_a_reply_is_not_called_offline(
    draw: Draw, fan: Any, presence: str, unusable: bool, expected: str
) -> None:
    """A drive whose replies had a stray byte before them was called offline, or never seen, on its tile and its bus."""
    text = {"en": "stray bytes come before its reply", "zh": "应答之前有杂散字节"}
    view = fan | {"presence": presence, "state": "unknown", "unusable_reply": {"text": text} if unusable else None}
    tile = draw("fleet/tile", "Tile", {"id": "fan-1"}, topics={"drives/fan-1": view}, only=".state")
    assert shown(tile, PRESENCES) == [expected]
    station = {"drive": "fan-1", "address": 1, "presence": presence, "error_rate": 1.0, "load_percent": 1.0}
    stations = {"stations": [station | {"errors": {}, "counters": {}}]}
    for part in ("BusTopology", "Stations"):
        drawn = draw("buses/bus-topology", part, stations, topics={"drives/fan-1": view})
        assert shown(drawn, PRESENCES) == [expected]


def test_a_drive_that_the_user_holds_in_another_window_is_not_requested_from_the_user(draw: Draw, fan: Any) -> None:
    """The page offered a user to ask themselves for control, but not a namesake at the command line of the machine."""
    keys = ["page.control_ask", "page.not_controlled_other", "page.not_controlled_window"]
    for lease, expected in ((OTHER_USER, keys[:2]), (NAMESAKE, keys[:2]), (OTHER_WINDOW, keys[2:])):
        text = draw("drive/control", "ControlPanel", {"view": fan | {"lease": lease}})
        assert shown(text, keys) == expected


def test_a_group_whose_drives_the_user_holds_in_another_window_is_requested_from_other_users_alone(
    draw: Draw, fan: Any
) -> None:
    leases = {"fan-1": OTHER_WINDOW, "fan-2": OTHER_WINDOW, "fan-3": OTHER_USER, "fan-4": NAMESAKE}
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=group_topics(fan, leases, "lease"))
    assert shown(text, ["page.control_ask_all"], n=2) and shown(text, ["page.group_other_window"], n=2)
    del leases["fan-3"], leases["fan-4"]
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=group_topics(fan, leases, "lease"))
    assert "Ask for control" not in text


def test_a_pause_and_a_ramp_hold_are_enabled_where_the_service_accepts_them(draw: Draw, fan: Any) -> None:
    """The page offered them during a jog, a braking or a restart, and beside another master; it got refusals."""
    able = fan | ONLINE_AND_STOPPED | {"lease": MINE, "capabilities": ["run", "stop", "pause", "hold_ramp"]}
    holds = ["page.hold_pause", "page.hold_ramp"]
    for state in DriveState:
        text = draw("drive/control", "ControlPanel", {"view": able | {"state": str(state)}}, only="button:disabled")
        assert shown(text, holds, n=5) == ([] if state in RUN_STATES else holds), state
    blocker = {"key": "drives.foreign_master", "params": {}, "text": {"en": "another master", "zh": "另一个主站"}}
    for blockers in ([], [blocker]):
        view = able | {"state": "running", "start_blockers": blockers}
        text = draw("drive/control", "ControlPanel", {"view": view}, only="button:disabled")
        assert shown(text, holds, n=5) == (holds if blockers else [])


def group_topics(fan: Any, values: dict[str, Any], name: str, leader: str | None = None) -> dict[str, Any]:
    """Return the topics of the group ``air`` with a drive for each value of the field ``name``."""
    drives = {f"drives/{id}": fan | {"id": id, "title": None, name: value} for id, value in values.items()}
    group = {"id": "air", "title": None, "drives": list(values), "leader": leader, "ratios": {}, "progress": None}
    return drives | {"groups/air": group | {"state": "stopped", "minimum_hz": 0.0, "maximum_hz": 50.0}}


def test_a_group_offers_the_frequencies_that_the_service_accepts_for_it(draw: Draw, fan: Any) -> None:
    """It offered 50 Hz where one drive was capped at 0.5 Hz and another gets twice the frequency of the group."""
    topics = group_topics(fan | ONLINE_AND_STOPPED, {"fan-1": 50.0, "fan-2": 50.0}, "maximum_hz")
    topics["groups/air"] |= {"minimum_hz": 0.1, "maximum_hz": 0.25}
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=topics)
    assert i18n.text("page.hz_limits", "en", minimum_hz=0.1, maximum_hz=0.25) in text
    assert "50 Hz" not in text


def test_a_capped_drive_offers_no_frequency_above_its_cap_and_says_why(draw: Draw, fan: Any) -> None:
    """The field names the cap before a command is rejected for it; where the limits are lower, it names them.

    Regression: beside a frequency above the cap stood "Must be 0.1 to 0.5 Hz" without the reason.
    """
    cases = (("", 50.0, "page.hz_capped", 0.5), ("", 0.4, "page.hz_limits", 0.4))
    refused = (("20", 50.0, "page.hz_capped", 0.5), ("20", 0.4, "page.hz_outside", 0.4))
    for value, maximum_hz, key, highest_hz in cases + refused:
        limits = {"minimum_hz": 0.1, "maximum_hz": maximum_hz, "setpoint_cap_hz": 0.5}
        props = {"label": "", "value": value, "onChange": None, "limits": limits}
        text = draw("control/frequency", "Frequency", props)
        assert i18n.text(key, "en", minimum_hz=0.1, maximum_hz=highest_hz) in text


@pytest.mark.parametrize(
    ("maximum_hz", "cap_hz", "key", "highest_hz"),
    [(2.5, None, "page.hz_none", 2.5), (50.0, 0.5, "page.hz_none_capped", 0.5)],
)
def test_limits_that_share_no_frequency_are_not_shown_as_a_range(
    draw: Draw, maximum_hz: float, cap_hz: float | None, key: str, highest_hz: float
) -> None:
    """A group of drives from 5 Hz and up to 2.5 Hz offered "5 to 2.5 Hz"; no frequency was accepted for it."""
    limits = {"minimum_hz": 5.0, "maximum_hz": maximum_hz, "setpoint_cap_hz": cap_hz}
    for value in ("", "3"):
        text = draw("control/frequency", "Frequency", {"label": "", "value": value, "onChange": None, "limits": limits})
        assert text.replace("Hz", "", 1).strip() == i18n.text(key, "en", minimum_hz=5, maximum_hz=highest_hz)


@pytest.mark.parametrize(
    ("leader", "offline", "is_blocked"),
    [("fan-1", "fan-2", True), ("fan-1", "a", True), ("fan-1", "fan-1", False), (None, "fan-2", False)],
)
def test_a_group_is_not_started_without_a_follower_of_its_leader(
    draw: Draw, fan: Any, leader: str | None, offline: str, is_blocked: bool
) -> None:
    """The service refused the start that the page offered. A leader without reply starts nothing by itself.

    The title of a drive whose id is "a" stood in the middle of the word "usable".
    """
    presences = {id: "offline" if id == offline else "online" for id in ("fan-1", "fan-2", "a")}
    topics = group_topics(fan, presences, "presence", leader)
    for id in presences:
        topics[f"drives/{id}"]["title"] = {"en": f"Title of {id}", "zh": id}
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=topics)
    names = {"drive": f"Title of {offline}", "leader": f"Title of {leader}"}
    reason = i18n.text("plant.member_offline", "en", group="air", **names)
    assert (reason in text) is is_blocked
    assert bool(shown(text, ["page.group_start_blocked"], n=1, of=3)) is is_blocked


@pytest.mark.parametrize("leader", ["fan-1", None])
def test_a_group_with_a_tripped_drive_names_it_before_its_start_is_pressed(
    draw: Draw, fan: Any, leader: str | None
) -> None:
    """The page offered a start that the service refuses."""
    states = {"fan-1": "stopped", "fan-2": "fault", "fan-3": "stopped"}
    topics = group_topics(fan | ONLINE_AND_STOPPED, states, "state", leader)
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=topics)
    assert i18n.text("plant.member_fault", "en", drive="fan-2", group="air") in text
    assert shown(text, ["page.group_start_blocked"], n=1, of=3)


@pytest.mark.parametrize("offline", [2, 3])
def test_a_group_of_offline_drives_offers_no_start_and_says_why(draw: Draw, fan: Any, offline: int) -> None:
    """A start in two steps was offered for a bus without port, and refused for each drive after it."""
    presences = {f"fan-{n}": "offline" if n < offline else "online" for n in range(3)}
    topics = group_topics(fan | ONLINE_AND_STOPPED, presences, "presence")
    text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=topics)
    assert bool(shown(text, ["page.group_not_online"])) is (offline == 3)


def test_the_offline_drives_of_a_group_are_counted(draw: Draw, fan: Any) -> None:
    keys = ["page.group_stopped", "page.group_offline"]
    for offline in (0, 2, 3):
        presences = {f"fan-{n}": "offline" if n < offline else "online" for n in range(3)}
        topics = group_topics(fan | ONLINE_AND_STOPPED, presences, "presence")
        text = draw("fleet/group-panel", "GroupPanel", {"id": "air"}, topics=topics, only=".row.between")
        assert shown(text, keys, n=offline, of=3) == (keys if offline else keys[:1])


@pytest.mark.parametrize(
    ("presence", "quality", "expected"),
    [
        ("online", "good", []),
        ("offline", "good", ["page.quality_uncertain", "page.before_offline"]),
        ("offline", "bad", ["page.quality_bad", "drives.stale"]),
    ],
)
def test_a_good_value_of_an_offline_drive_is_marked_as_its_last_one(
    draw: Draw, fan: Any, presence: str, quality: str, expected: list[str]
) -> None:
    """Regression: a drive that is read every 10 s was shown at a live 50 Hz for half a minute after it fell silent."""
    reason = "drives.stale" if quality == "bad" else None
    frequency = {"value": 50.0, "unit": "Hz", "quality": quality, "reason": reason, "source_time_ms": 1, "readAt": 1}
    view = fan | {"presence": presence, "signals": {"output_frequency": frequency}}
    for module, part, props in (("drive/values", "Values", {"view": view}), ("fleet/tile", "Tile", {"id": "fan-1"})):
        text = draw(module, part, props, topics={"drives/fan-1": view}, only=".value")
        keys = ["page.quality_uncertain", "page.before_offline", "page.quality_bad", "drives.stale"]
        assert shown(text, keys) == expected, (module, text)


def parameter(count: int, **fields: Any) -> dict[str, Any]:
    """Return a parameter with this many choices."""
    choices = {str(n): {"en": f"choice {n}", "zh": f"选项 {n}"} for n in range(count)}
    return {"choices": choices, "choices_complete": True, "minimum": None, "maximum": None} | fields


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (parameter(0), "–"),
        (parameter(0, minimum=0.5, maximum=60), "0.5 … 60"),
        (parameter(2), "0 choice 01 choice 1"),
        (parameter(2, choices_complete=False, minimum=0, maximum=9), "0 … 90 choice 01 choice 1…"),
        (parameter(1, choices_complete=False), "0 choice 0…"),
        (parameter(5), "0 … 4" + "".join(f"{n} choice {n}" for n in range(5))),
    ],
)
def test_the_choices_of_a_parameter_are_named_and_not_counted(draw: Draw, found: Any, expected: str) -> None:
    assert draw("drive/parameter-text", "Range", {"parameter": found}) == expected


def test_an_alarm_of_an_interlock_has_its_title_and_not_its_id(draw: Draw, fan: Any) -> None:
    """Beside the drive stood the id of plant.toml."""
    title = Text("Fans need a pump", "风机需要水泵")
    alarm = system_alarm(
        "1",
        SystemAlarm.INTERLOCK_TRIP,
        drive="fan-1",
        name=Text("fan", "风机"),
        now_ms=0,
        subject="cool",
        params={"interlock": title},
    )
    text = draw("alarms/alarm-rows", "AlarmRows", {"alarms": [alarm.as_json()]}, topics={"drives/fan-1": fan})
    assert 'Interlock "Fans need a pump"' in text and "cool" not in text


def test_a_drive_is_called_blocked_only_where_the_service_gives_a_reason(draw: Draw, fan: Any) -> None:
    reason = {"key": "interlocks.violated", "text": {"en": "the interlock is open", "zh": "联锁断开"}, "params": {}}
    for blockers in ([], [reason]):
        text = draw("drive/control", "ControlPanel", {"view": fan | {"start_blockers": blockers}})
        assert shown(text, ["page.blocked"]) == ["page.blocked"] * len(blockers)
        assert ("the interlock is open" in text) is bool(blockers)


@pytest.mark.parametrize(
    ("changed", "connection", "expected"),
    [
        ({}, "live", "page.no_present_fault"),
        ({"state": "unknown"}, "live", "page.not_known"),
        ({"presence": "offline"}, "live", "page.not_known"),
        ({}, "lost", "page.not_known"),
    ],
)
def test_the_place_of_a_fault_says_whether_there_is_one_or_that_it_is_unknown(
    draw: Draw, fan: Any, changed: Any, connection: str, expected: str
) -> None:
    """Regression: it was empty where the drive or the connection was lost."""
    view = fan | ONLINE_AND_STOPPED | changed
    text = draw("drive/current-fault", "CurrentFault", {"view": view}, connection=connection)
    assert shown(text, ["page.no_present_fault", "page.not_known"]) == [expected]


OVERHEAT = {"code": 5, "label": "", "text": {"en": "overheat", "zh": "过热"}, "cause": None, "remedy": None}


def test_the_page_of_a_drive_names_its_own_alarms_each_once(draw: Draw, fan: Any) -> None:
    """The head read *reports no fault* while an alarm of this drive was open."""

    def alarm(which: SystemAlarm = SystemAlarm.OTHER_SPEED, *, title: str = "", **more: Any) -> dict[str, Any]:
        params = {"found_hz": 40.0, "set_hz": 25.0, "interlock": "cool"}
        raised = system_alarm("1", which, drive="fan-1", name=Text("fan", "风机"), now_ms=0, subject="", params=params)
        return raised.as_json() | more | ({"title": {"en": title, "zh": title}} if title else {})

    trip = alarm(title="TRIPPED", kind="fault", value=5.0)
    speed, interlock = alarm(), alarm(SystemAlarm.INTERLOCK_TRIP)
    foreign = alarm(title="OF ANOTHER", drive="fan-2")
    shelved = alarm(title="SHELVED", shelved_until_ms=10**15)
    cleared = alarm(title="CLEARED", cleared_ms=1)
    title, sentence = speed["title"]["en"], speed["text"]["en"]
    assert "40" in sentence and sentence not in title

    def text_of(changed: dict[str, Any], *active: dict[str, Any]) -> str:
        view = fan | ONLINE_AND_STOPPED | changed
        topics = {"alarms": {"active": list(active)}, "drives/fan-1": view}
        return draw("drive/current-fault", "CurrentFault", {"view": view}, topics=topics)

    quiet = [foreign, shelved, cleared]
    no_fault = i18n.text("page.no_present_fault", "en")
    more = i18n.text("page.more_alarms", "en", n=1)
    text = text_of({}, speed, *quiet)
    assert (text.count(no_fault), text.count(title), text.count(sentence)) == (1, 1, 1)
    assert not [word for word in ("OF ANOTHER", "SHELVED", "CLEARED", more) if word in text]
    text = text_of({}, speed, interlock)
    assert interlock["title"]["en"] in text and more in text
    assert title in text_of({"presence": "offline"}, speed)
    fault = {"state": "fault", "fault": OVERHEAT}
    assert "TRIPPED" not in text_of(fault, trip)
    text = text_of(fault, trip, speed, *quiet)
    assert (text.count("overheat"), text.count(title)) == (1, 1)
    assert not [word for word in ("TRIPPED", "OF ANOTHER", "SHELVED", "CLEARED", more) if word in text]
    without_status = {"state": "unknown", "capabilities": ["run", "stop"]}
    assert sentence in text_of(without_status, speed)
    assert text_of(without_status, *quiet) == i18n.text("page.no_drive_alarm", "en")


def test_an_alarm_of_a_drive_that_a_reload_has_replaced_is_not_shown_as_one_of_its_successor(
    draw: Draw, fan: Any
) -> None:
    """The tile and the page of the new motor had the mark of a fault that another one had, and the list led there."""
    kind, name = SystemAlarm.INTERLOCK_TRIP, Text("old fan", "旧风机")
    raised = system_alarm("1", kind, drive="fan-1", name=name, now_ms=0, subject="", params={"interlock": "cool"})
    view = fan | ONLINE_AND_STOPPED
    to_acknowledge = i18n.text("page.alarms_to_acknowledge", "en")
    replaced = i18n.text("page.alarm_drive_replaced", "en", drive="fan-1")
    for is_replaced in (False, True):
        alarm = raised.as_json() | {"cleared_ms": 1, "drive_replaced": is_replaced}
        topics = {"alarms": {"active": [alarm]}, "drives/fan-1": view}
        assert (
            to_acknowledge in draw("drive/current-fault", "CurrentFault", {"view": view}, topics=topics)
        ) is not is_replaced
        assert bool(draw("fleet/tile", "Tile", {"id": "fan-1"}, topics=topics, only=".priority")) is not is_replaced
        for module, part, props in (
            ("alarms/alarm-rows", "AlarmRows", {"alarms": [alarm]}),
            ("alarms/alarm-strip", "AlarmStrip", {}),
        ):
            assert (replaced in draw(module, part, props, topics=topics)) is is_replaced
            links = draw(module, part, props, topics=topics, only="a[href*=fan-1]")
            assert bool(links) is not is_replaced


def test_the_last_stop_has_its_kind_and_its_user(draw: Draw, fan: Any) -> None:
    keys = {
        "drive": "page.last_stop_drive",
        "group": "page.last_stop_group",
        "all": "page.last_stop_all",
        "jog": "page.last_stop_jog",
        "service": "page.last_stop_service",
        "test": "page.last_stop_test",
        "automatic": "page.last_stop_automatic",
    }
    for kind in (None, *keys):
        last = kind and {"kind": kind, "actor": "ann", "time_ms": 1}
        text = draw("drive/control", "ControlPanel", {"view": fan | {"last_stop": last}})
        found = shown(re.sub(r" ended, ", " ended,", text), keys.values(), actor="ann", time="")
        assert found == ([keys[kind]] if kind else [])


def comm_loss(kind: str = "unknown", result: str = "", *, holds: bool = True, phase: str = "") -> Any:
    tested = {"result": result, "holds": holds, "silence_s": 6.0} if result else None
    test = {"phase": phase, "until_ms": 6000 if phase == "silent" else None} if phase else None
    return {"kind": kind, "after_s": 6, "waiver": None, "tested": tested, "test": test, "no_result": None}


@pytest.mark.parametrize(
    ("badge", "expected"),
    [
        (comm_loss("trips"), "page.comm_loss_trips"),
        (comm_loss("runs_on"), "page.comm_loss_runs_on"),
        (comm_loss("unknown"), "page.comm_loss_unknown"),
        (comm_loss("trips", "trips"), "page.comm_loss_tested_trips"),
        (comm_loss("trips", "stops"), "page.comm_loss_tested_stops"),
        (comm_loss("runs_on", "runs_on"), "page.comm_loss_tested_runs_on"),
        (comm_loss("trips", "runs_on", holds=False), "page.comm_loss_trips"),
        (comm_loss("unknown", "trips", holds=False), "page.comm_loss_unknown"),
    ],
)
def test_a_reaction_to_a_communication_loss_is_called_tested_only_while_its_test_counts(
    draw: Draw, badge: Any, expected: str
) -> None:
    assert draw("drive/comm-loss", "CommLossBadge", {"badge": badge}) == i18n.text(expected, "en", after=6)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (comm_loss(), []),
        (comm_loss("trips", "trips"), []),
        (comm_loss("unknown", "trips", holds=False), ["page.comm_loss_outdated"]),
        (comm_loss(phase="starting"), ["page.comm_loss_phase_starting"]),
        (comm_loss(phase="turning"), ["page.comm_loss_phase_turning"]),
        (comm_loss(phase="silent"), ["page.comm_loss_phase_silent"]),
        (comm_loss("unknown", "trips", holds=False, phase="reading"), ["page.comm_loss_phase_reading"]),
    ],
)
def test_a_communication_loss_test_shows_its_phase_and_a_record_that_no_longer_counts(
    draw: Draw, fan: Any, found: Any, expected: list[str]
) -> None:
    text = draw("drive/comm-loss-test", "CommLossTest", {"view": fan | {"comm_loss": found}})
    phases = [f"page.comm_loss_phase_{phase}" for phase in ("starting", "turning", "silent", "reading")]
    text = re.sub(r"for \d+ s more", "for N s more", text)
    assert shown(text, [*phases, "page.comm_loss_outdated"], seconds="N") == expected


def test_a_communication_loss_test_without_a_result_shows_its_reason(draw: Draw, fan: Any) -> None:
    found = comm_loss() | {"no_result": {"en": "it did not reach a steady run", "zh": "x"}}
    text = draw("drive/comm-loss-test", "CommLossTest", {"view": fan | {"comm_loss": found}})
    assert "it did not reach a steady run" in text


STOP_STATES = (
    "page.stop_sending",
    "page.stop_waiting",
    "page.stop_trying",
    "page.stop_done",
    "page.stop_failed",
    "page.stop_not_sure",
)


@pytest.mark.parametrize(
    ("entry", "connection", "expected"),
    [
        ({"phase": "sending"}, "live", "page.stop_sending"),
        ({"phase": "sending"}, "lost", "page.stop_waiting"),
        ({"phase": "trying"}, "lost", "page.stop_trying"),
        ({"phase": "done", "good": True}, "live", "page.stop_done"),
        ({"phase": "done", "good": False}, "live", "page.stop_not_sure"),
        ({"phase": "failed", "good": False}, "live", "page.stop_failed"),
    ],
)
def test_a_stop_is_called_what_the_service_answered(draw: Draw, entry: Any, connection: str, expected: str) -> None:
    stops = [
        {"id": 1, "target": {"kind": "drive", "id": "fan-1"}, "how": "stop", "time_ms": 1, "why": "because"} | entry
    ]
    text = draw("control/stop-bar", "StopBar", {}, connection=connection, stops=stops)
    assert shown(text, STOP_STATES, what="fan-1", why="because") == [expected]


def test_a_name_from_right_to_left_is_isolated_from_the_words_around_it(draw: Draw, blank: Any, fan: Any) -> None:
    """The number and the signs after the name changed their places with it, and the names of a list their order."""
    name, stops = "משאבה 1", [{"id": 1, "target": {"kind": "drive", "id": "fan-1"}, "phase": "sending", "time_ms": 1}]
    for title, expected in ((name, f"\u2068{name}\u2069"), ("Fan 1", "Fan 1")):
        topics = {"drives/fan-1": fan | {"title": {"en": title, "zh": title}}}
        text = draw("control/stop-bar", "StopBar", {}, stops=stops, topics=topics)
        assert i18n.text("page.stop_sending", "en", what=expected) in text
    names = blank.evaluate("(name) => import('/static/js/titles.js').then((m) => m.shortList([name, 'Fan']))", name)
    assert names == f"\u2068{name}\u2069, Fan"


def test_only_a_stop_that_is_being_repeated_is_called_not_confirmed_yet(draw: Draw, fan: Any) -> None:
    for pending in (False, True):
        topics = {"drives/fan-1": fan | {"stop_pending": pending}}
        text = draw("fleet/tile", "Tile", {"id": "fan-1"}, topics=topics)
        assert shown(text, ["page.stop_pending_short"]) == ["page.stop_pending_short"] * pending
        text = draw("pages/drive", "Page", {"id": "fan-1", "query": {}}, topics=topics)
        assert shown(text, ["page.stop_pending"]) == ["page.stop_pending"] * pending


def test_a_bus_that_has_hardly_any_time_left_is_called_full_and_no_interval_of_its_polls_is_promised(
    draw: Draw, fan: Any, plant: Stage
) -> None:
    """Regression: its bar was amber without a word, and below it stood an interval that its polls no longer kept."""
    slow = fan | {"poll_interval_s": 15.0, "requested_interval_s": 0.5}
    keys = ["page.bus_full", "page.bus_full_is", "page.bus_full_why", "page.bus_polls_slowly_why"]
    for occupied in (89.9, 90.0):
        view = plant.call("buses.get", bus="fans") | {"occupied_percent": occupied}
        topics = {"buses/fans": view, "drives/fan-1": slow}
        text = draw("pages/buses", "Page", {"id": "fans"}, topics=topics)
        assert shown(text, keys, share=f"{occupied} %", serial=view["serial"]) == (
            keys[3:] if occupied < 90 else keys[:3]
        )


@pytest.mark.parametrize(("is_open", "connection"), [(False, "live"), (True, "lost")])
def test_without_its_port_or_a_live_connection_the_load_of_a_bus_is_not_known(
    draw: Draw, plant: Stage, is_open: bool, connection: str
) -> None:
    """Regression: the last load before that stood there as if it were measured now."""
    view = plant.call("buses.get", bus="fans")
    stations = [station | {"load_percent": 21.4} for station in view["stations"]]
    view |= {"load_percent": 41.4, "occupied_percent": 95.5, "transactions_per_s": 12.5, "stations": stations}
    figures = ["41.4", "95.5", "96 %", "12.5", "21.4", i18n.text("page.bus_full", "en")]
    known = draw("pages/buses", "Page", {"id": "fans"}, topics={"buses/fans": view})
    assert [value for value in figures if value not in known] == []
    lost = {"buses/fans": view | {"is_open": is_open}}
    text = draw("pages/buses", "Page", {"id": "fans"}, topics=lost, connection=connection)
    assert [value for value in figures if value in text] == []
    assert shown(text, ["page.state_was"]) == ["page.state_was"] * (connection == "lost")


def test_another_master_is_named_on_its_bus_alone(draw: Draw, plant: Stage) -> None:
    keys = ["page.foreign_master", "page.foreign_master_why"]
    for foreign in (False, True):
        view = plant.call("buses.get", bus="fans") | {"foreign_master": foreign}
        text = draw("pages/buses", "Page", {"id": "fans"}, topics={"buses/fans": view})
        assert shown(text, keys) == (keys if foreign else [])


def test_only_a_request_that_may_have_an_effect_has_an_unknown_outcome_without_an_answer(blank: Any) -> None:
    blank.route("**/api/v1/lost", lambda route: route.abort())
    call = (
        "(method) => import('/static/js/api.js').then((m) => m.api[method]('/lost')).catch((error) => error.sentence)"
    )
    assert blank.evaluate(call, "post") == i18n.text("page.unreachable", "en")
    assert blank.evaluate(call, "get") == i18n.text("page.no_answer", "en")


def test_a_takeover_is_named_by_its_user_and_by_whether_this_page_saw_it(draw: Draw) -> None:
    keys = {
        ("bob", "taken", 1): "page.taken",
        ("bob", "taken", None): "page.taken_unseen",
        ("me", "window", 1): "page.taken_window",
        ("me", "window", None): "page.taken_window_unseen",
    }
    for (owner, cause, time_ms), key in keys.items():
        takeover = {"drive": "fan-1", "owner": owner, "cause": cause, "time_ms": time_ms}
        text = re.sub(r"\d\d:\d\d:\d\d", "TIME", draw("shell", "Shell", {}, takeovers=[takeover]))
        assert shown(text, keys.values(), owner=owner, name="fan-1", time="TIME") == [key]
        assert shown(draw("shell", "Shell", {}), keys.values(), owner=owner, name="fan-1", time="TIME") == []


@pytest.mark.parametrize("closed", [None, {"en": "The service is ending.", "zh": "B"}])
@pytest.mark.parametrize(("connection", "is_lost"), [("live", False), ("starting", False), ("lost", True)])
def test_a_lost_connection_is_explained_by_the_page_also_where_the_server_gave_a_reason(
    draw: Draw, connection: str, closed: Any, is_lost: bool
) -> None:
    """Regression: *The service is ending* stood in place of what the page shows and of where to stop in danger."""
    text = draw("shell", "Shell", {}, connection=connection, closed=closed)
    how = i18n.text("page.offline_how", "en")
    assert (how in text) == is_lost
    assert (f"{(closed or {}).get('en')} {how}" in text) == (is_lost and closed is not None)


def test_a_connection_that_is_lost_between_two_ticks_of_the_page_is_lost_for_no_negative_time(draw: Draw) -> None:
    """Regression: *Connection lost for -0.0 s.* The last message may be newer than the time that the page shows."""
    text = draw("shell", "Shell", {}, connection="lost", lost_ms=40)
    assert i18n.text("page.offline", "en", age=i18n.text("page.seconds", "en", n="0.0")) in text


def test_the_notice_of_a_lost_connection_names_a_page_that_has_moved_and_promises_no_stop() -> None:
    """The notice read *Bus stops are still sent*, and had no word for a page that a reload has moved."""
    for language, expected, promise in (
        (
            "en",
            ("another address", "log of the service", "for 30 s until the service answers", "stop at the machine"),
            "still sent",
        ),
        ("zh", ("其他地址", "服务日志", "30 秒内会重复发送，直到服务应答", "到现场停机"), "仍会发送"),
    ):
        text = i18n.text("page.offline_how", language)
        assert [words for words in expected if words not in text] == []
        assert promise not in text


@pytest.mark.parametrize("above_hz", [40.5, None])
def test_the_limits_say_that_a_drive_runs_above_them(draw: Draw, fan: Any, above_hz: float | None) -> None:
    """A limit that is lowered slows no motor."""
    text = draw("drive/limits", "Limits", {"view": fan | {"above_limit_hz": above_hz}})
    assert (i18n.text("page.limits_above", "en", frequency_hz=40.5) in text) == (above_hz is not None)


@pytest.mark.parametrize(("cap_hz", "is_capped"), [(0.5, True), (45.0, False), (None, False)])
def test_the_limits_name_the_cap_of_a_setpoint_that_is_not_calibrated_and_what_ends_it(
    draw: Draw, fan: Any, cap_hz: float | None, is_capped: bool
) -> None:
    """Regression: *Allowed: 0 to 400 Hz* stood beside a drive that accepts 0.5 Hz."""
    text = draw("drive/limits", "Limits", {"view": fan | {"maximum_hz": 45.0, "setpoint_cap_hz": cap_hz}})
    assert (i18n.text("page.limits_capped", "en", maximum_hz=0.5) in text) == is_capped


def test_limits_of_a_service_that_reports_no_excess_name_none(draw: Draw, fan: Any) -> None:
    """Regression: "The drive runs at undefined Hz", from a service that ran on while its files were upgraded."""
    view = {name: value for name, value in fan.items() if name != "above_limit_hz"}
    assert i18n.text("page.limits_above", "en", frequency_hz="undefined") not in draw(
        "drive/limits", "Limits", {"view": view}
    )
