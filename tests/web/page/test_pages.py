"""Buses, alarms, incidents, audit and settings in a real browser on a real plant with simulated drives."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.alarms import SystemAlarm
from drivebus.service.runtime import configuration_check
from fixtures.browser import Stage, log_in
from fixtures.browser_actions import DRAWN, expecting, trip, unplugged, wait_until
from fixtures.web_app import PASSWORD


def word(key: str, **params: Any) -> str:
    return i18n.text(f"page.{key}", "en", **params)


@pytest.fixture
def expect() -> Any:
    return expecting()


# --- buses --------------------------------------------------------------------------------------------------------


def test_a_bus_shows_its_stations_in_cable_order_with_their_replies(visit: Any, expect: Any) -> None:
    page = visit("#/buses/fans")
    rows = page.locator(".wide-table tbody tr")
    expect(rows).to_have_count(3)
    assert [row.locator("td").nth(0).inner_text() for row in rows.all()] == [
        "Supply fan",
        "Extract fan",
        "Flue gas fan",
    ]
    expect(rows.first.locator(".replybar .number")).to_have_text(re.compile(r"^[\d.]+ ms / [\d.]+ ms$"))
    names = page.locator(".cable .name").all_inner_texts()
    assert names == [word("host"), "Supply fan", "Extract fan", "Flue gas fan"]


def test_the_table_of_stations_keeps_names_on_one_line_on_a_tablet(visit: Any, expect: Any) -> None:
    """Regression: each name took three lines, beside wide columns, so a bus of thirty drives filled ten screens."""
    page = visit("#/buses/pumps", size=(820, 1180))
    name = page.locator(".wide-table tbody td a").first
    expect(name).to_have_text("Circulation pump")
    assert len(name.evaluate("one => [...one.getClientRects()].map(({ top }) => top)")) == 1


def test_decoded_frames_scroll_until_they_are_paused(visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    frames = page.locator(".frames-box .frame")
    expect(frames.nth(10)).to_be_visible()
    assert re.fullmatch(r"([0-9A-F]{2} )+[0-9A-F]{2}", frames.locator(".hex").nth(0).inner_text())
    assert page.locator(".frames-box .frame .frame-text").first.inner_text() != ""
    page.click("[data-frames=pause]")
    expect(page.locator("[data-frames=pause]")).to_have_attribute("aria-pressed", "true")
    held = frames.last.inner_text()
    expect(page.locator(".framelog [role=status]")).not_to_have_text(word("paused", n=0))
    assert frames.last.inner_text() == held
    page.click("[data-frames=pause]")
    expect(frames.last).not_to_have_text(held)


def test_frames_are_filtered_by_direction_station_and_content(visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    page.get_by_role("button", name=word("frames_sent"), exact=True).click()
    page.select_option(".framelog select", "2")
    expect(page.locator(".frame.sent .station").first).to_have_text("2")
    assert set(page.locator(".frame .station").all_inner_texts()) == {"2"}
    assert page.locator(".frame:not(.sent)").count() == 0
    page.fill(".framelog input[type=search]", "02 03")
    expect(page.locator(".frame .hex").first).to_contain_text("02 03")
    page.fill(".framelog input[type=search]", "no frame says this")
    expect(page.locator(".frames-box .help")).to_have_text(word("no_frames"))


def test_a_bus_shows_a_missing_adapter_until_it_is_back(stage: Stage, visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    card = page.locator(".buscard[aria-current]")
    expect(card).to_contain_text(word("bus_open"))
    with unplugged(stage, "pumps"):
        expect(card).to_contain_text(word("bus_closed"))
        expect(page.locator(".notice.bad").first).to_contain_text(word("bus_closed_why", port="sim://vc660@1,2?ramp=2"))
        reply_text = i18n.text("alarms.text.port_lost", "en", bus="Pump line", reason="")
        expect(page.locator(".banner.alarm a", has_text=reply_text).first).to_be_visible()
        page.evaluate("location.hash = '#/alarms'")
        expect(page.locator(".alarmrow a[href='#/buses/pumps']").first).to_have_text("Pump line")
        page.go_back()
    expect(card).to_contain_text(word("bus_open"))


def test_on_a_phone_a_chosen_bus_is_in_sight_and_the_others_are_a_link_away(visit: Any, expect: Any) -> None:
    """Regression: the facts of a bus stood below the cards of all buses."""
    page = visit("#/buses/pumps", size=(360, 740))
    expect(page.locator(".buscard")).to_have_count(2)
    assert page.locator(".buscard").evaluate_all("all => all.map((one) => one.offsetParent !== null)") == [False, True]
    page.get_by_role("link", name=word("all_buses")).click()
    expect(page.locator(".buscard").first).to_be_visible()
    page.set_viewport_size({"width": 1440, "height": 900})
    page.locator(".buscard").last.click()
    expect(page.locator(".buscard").first).to_be_visible()


# --- alarms -------------------------------------------------------------------------------------------------------


def test_an_alarm_is_acknowledged_and_its_incident_opened(stage: Stage, visit: Any, expect: Any) -> None:
    charted = ("output_frequency", "dc_bus_voltage", "output_voltage")
    stage.wait(
        lambda: all(stage.view("fan-3")["signals"][name]["value"] is not None for name in charted),
        "a plant that has just begun has not read every signal",
    )
    trip(stage, "fan-3")
    page = visit("#/alarms", role="operator")
    row = page.locator(".alarmrow", has_text="Flue gas fan").first
    expect(row.locator(".alarmstate")).to_have_text(word("alarm_unacknowledged"))
    row.locator("[data-alarm=acknowledge]").click()
    expect(row.locator(".alarmstate")).to_have_text(word("alarm_acknowledged"))
    row.get_by_role("link", name=word("open_incident")).click()
    expect(page.locator("h1")).to_contain_text("Flue gas fan")
    expect(page.locator(".notice.bad").first).to_contain_text("Flue gas fan")
    expect(page.locator(".trend-plot canvas")).to_be_visible()
    expect(page.locator(".trend-readout tbody tr").first).to_contain_text("output frequency")
    shown = page.locator(".trend-readout tbody tr:not(.off) th").all_inner_texts()
    assert shown == [i18n.text(f"signal.{name}", "en") for name in charted]
    frames = page.get_by_role("region", name=word("frames_title"))
    assert frames.locator("tbody tr").count() > 20
    with page.expect_download() as saved:
        page.get_by_role("button", name=word("save_capture")).click()
    assert saved.value.suggested_filename.endswith(".dbcap") and saved.value.path().stat().st_size > 200
    page.locator(".notes input").fill("bearing exchanged")
    page.locator(".notes button[type=submit]").click()
    expect(page.locator(".notes li")).to_contain_text(["bearing exchanged"])
    expect(page.locator(".notes li b")).to_have_text("operator")
    page.route("**/api/v1/incidents/*", unread)
    page.reload()
    parameters = page.get_by_role("region", name=word("incident_parameters")).locator("tbody tr")
    expect(parameters.filter(has_text="F9.4")).to_contain_text(i18n.text("drives.no_answer", "en"))
    expect(page.locator(".notice.warning")).to_contain_text(UNREAD_CAPTURE["en"])
    assert not page.get_by_role("button", name=word("save_capture")).is_visible()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_list_of_incidents_tells_them_apart_by_their_faults(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """Regression: each row had the word "fault" and nothing about which one."""
    trip(stage, "fan-3")
    fault = stage.view("fan-3")["fault"]
    page = visit("#/alarms?tab=incidents", language=language)
    row = page.locator(".incidents a", has_text={"en": "Flue gas fan", "zh": "引风机"}[language]).first
    expect(row).to_contain_text(i18n.text("alarms.title.fault", language))
    expect(row).to_contain_text(fault["label"])
    expect(row).to_contain_text(fault["text"][language].split(fault["label"])[-1])


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_event_of_an_incident_that_is_no_command_has_its_own_sign(stage: Stage, visit: Any, language: str) -> None:
    """A lost station had the mark of a command in the chart, and "page.event_presence" for a screen reader."""
    trip(stage, "fan-3")
    page = visit("#/alarms?tab=incidents", language=language)

    def with_event(route: Any) -> None:
        answer = route.fetch()
        found = answer.json()
        event = {
            "id": "e",
            "time_ms": found["time_ms"] - 20_000,
            "kind": "presence",
            "drive": found["drive"],
            "text": {"en": "offline", "zh": "离线"},
            "actor": None,
        }
        route.fulfill(response=answer, json=found | {"events": [event]})

    page.route("**/api/v1/incidents/*", with_event)
    page.locator(".incidents a").first.click()
    page.click(".trend-events summary")
    row = page.locator(".trend-events .event-other")
    row.wait_for()
    assert row.locator(".sr").inner_text() == i18n.text("page.event_other", language)
    assert row.locator(".sign").inner_text() == "●"


@pytest.mark.parametrize("language", ["en", "zh"])
def test_parameters_of_a_recent_incident_appear_once_they_are_read(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """Right after the trip the page showed that they could not be read, and never changed that."""
    trip(stage, "fan-3")
    page = visit("#/alarms?tab=incidents", language=language)
    read = {"raw": 50, "value": 5.0, "unit": "s", "quality": "good", "reason": None}
    found = {"parameters": None, "time_ms": time.time() * 1000}
    page.route("**/api/v1/incidents/*", lambda route: route.fulfill(json=route.fetch().json() | found))
    page.locator(".incidents a").first.click()
    parameters = page.locator(".panel", has=page.get_by_text(i18n.text("page.incident_parameters", language)))
    expect(parameters.locator(".help")).to_have_text(i18n.text("page.parameters_being_read", language))
    found["parameters"] = {"F0.9": read}
    expect(parameters.locator("tbody td").first).to_have_text("F0.9")
    found |= {"parameters": None, "time_ms": (time.time() - 121) * 1000}
    page.reload()
    expect(parameters.locator(".help")).to_have_text(i18n.text("page.parameters_not_read", language))


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", [(1440, 900), (360, 740)])
def test_a_parameter_that_is_read_during_a_fault_is_shown_as_uncertain_with_its_reason(
    stage: Stage, visit: Any, expect: Any, size: tuple[int, int], language: str
) -> None:
    """Regression: in the incident and on the drive's page it looked like any other value."""
    trip(stage, "fan-3")
    note = i18n.text("page.quality_uncertain", language) + i18n.text("page.colon", language)
    note += i18n.text("drives.item_not_echoed", language)
    for address, read in (
        ("#/drive/fan-3?tab=parameters", "[data-do=read]"),
        ("#/alarms?tab=incidents", ".incidents a"),
    ):
        page = visit(address, size=size, language=language)
        page.locator(read).first.click()
        row = page.locator("tr", has=page.locator("code:text-is('F0.1')"))
        expect(row.locator(".doubtful")).to_have_text(note)
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]


UNREAD_CAPTURE = {"en": "the frames cannot be read", "zh": "无法读取报文"}


def unread(route: Any) -> None:
    """Answer with an incident whose parameters could not be read, nor the file of its frames."""
    answer = route.fetch()
    silent = {"raw": None, "value": None, "unit": "", "quality": "bad", "reason": "drives.no_answer"}
    found = {"parameters": {"F9.4": silent}, "capture": None, "capture_problem": UNREAD_CAPTURE}
    route.fulfill(response=answer, json=answer.json() | found)


def test_the_faults_of_the_statistics_have_the_labels_of_the_keypad(stage: Stage, visit: Any, expect: Any) -> None:
    """They read "3: 3", and a code without a label was a bare number."""
    fault = {"code": 3, "label": "Fu.3", "text": {"en": "over-current", "zh": "过电流"}}

    def answer_with(name: str, faults: Any) -> None:
        def change(route: Any) -> None:
            answer = route.fetch()
            route.fulfill(response=answer, json=answer.json() | {"faults": faults})

        page.route(f"**/api/v1/drives/fan-3/{name}", change)

    page = visit("#/drive/fan-2")
    answer_with("profile", [fault])
    answer_with("statistics", {"3": 3, "9999": 1, "-1": 2})
    page.goto(f"{stage.at}/#/drive/fan-3?tab=statistics")
    expect(page.locator("[role=tabpanel]")).to_contain_text(
        f"Fu.3 × 3, {word('fault_code', code=9999)} × 1, {i18n.text('drives.unnamed_fault', 'en')} × 2"
    )


UNLABELLED_FAULT: dict[str, Any] = {"code": -1, "label": "", "text": {"en": "a fault", "zh": "故障"}, "cause": None}


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_states_of_an_incident_show_the_text_of_a_fault_that_has_no_label(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """The cell of a fault without a label was empty."""
    trip(stage, "fan-3")
    labelled = stage.view("fan-3")["fault"]
    state = {"state": "fault", "presence": "online", "commanded_hz": None}
    states = [state | {"t": -n, "fault": fault} for n, fault in enumerate((None, labelled, UNLABELLED_FAULT))]

    def changed(route: Any) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"states": states})

    page = visit("#/alarms?tab=incidents", language=language)
    page.route("**/api/v1/incidents/*", changed)
    page.locator(".incidents a").first.click()
    table = page.get_by_role("region", name=i18n.text("page.incident_states", language))
    cells = table.locator("tbody td:nth-child(3)")
    expect(cells).to_have_text(["–", labelled["label"], UNLABELLED_FAULT["text"][language]])


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_incident_names_cause_and_remedy_as_the_drive_does(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """The two words stood twice in the catalogue, so that one of the two pages could change alone."""
    trip(stage, "fan-3")
    fault = stage.view("fan-3")["fault"]
    advice = {name: {"en": f"{name} of the test", "zh": f"试验{name}"} for name in ("cause", "remedy")}

    def explained(route: Any) -> None:
        answer = route.fetch()
        found = answer.json()
        found["view"]["fault"] |= advice
        route.fulfill(response=answer, json=found)

    page = visit("#/alarms", language=language)
    page.route("**/api/v1/incidents/*", explained)
    row = page.locator(".alarmrow", has_text={"en": "Flue gas fan", "zh": "引风机"}[language]).first
    row.get_by_role("link", name=i18n.text("page.open_incident", language)).click()
    box = page.locator(".notice.bad").first
    for name, text in advice.items():
        label = i18n.text(f"page.{name}", language) + i18n.text("page.colon", language)
        expect(box).to_contain_text(label + text[language])
    label, text = fault["label"], fault["text"][language]
    shown = box.inner_text()
    assert (shown.count(label), shown.count(text.split(label)[-1].strip())) == (1, 1)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_incident_of_an_interlock_names_it_once(stage: Stage, visit: Any, expect: Any, language: str) -> None:
    """The title and the sentence of the incident named the interlock one below the other."""
    trip(stage, "fan-3")
    names = {"interlock": "Damper open", "drive": "Flue gas fan"}
    texts = {part: i18n.text(f"alarms.{part}.interlock_trip", language, **names) for part in ("title", "text")}

    def of_interlock(route: Any) -> None:
        answer = route.fetch()
        found = answer.json() | texts
        found["view"]["fault"] = None
        route.fulfill(response=answer, json=found)

    page = visit("#/alarms?tab=incidents", language=language)
    page.route("**/api/v1/incidents/*", of_interlock)
    page.locator(".incidents a").first.click()
    expect(page.locator(".notice.bad").first).to_have_text(texts["text"])


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_command_in_the_text_of_an_alarm_is_shown_as_code(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """The backticks of the catalogue were shown."""
    kind, command = SystemAlarm.AUDIT_INCOMPLETE, "drivebus audit verify"
    plant = stage.service.plant

    async def change(raise_or_clear: Any) -> None:
        raise_or_clear(kind, subject="audit.jsonl")

    stage.do(lambda: change(plant.raise_alarm))
    try:
        page = visit("#/alarms", language=language)
        row = page.locator(".alarmrow", has_text="audit.jsonl").first
        row.locator("summary").click()
        expect(row.locator("code")).to_have_text([command, command])
        expect(row).not_to_contain_text("`")
    finally:
        stage.do(lambda: change(plant.clear_alarm))


def test_an_alarm_is_shelved_with_a_reason_and_taken_back(stage: Stage, visit: Any, expect: Any) -> None:
    trip(stage, "pump-2")
    page = visit("#/alarms")
    row = page.locator(".alarmrow", has_text="Feed pump").first
    row.get_by_role("button", name=word("shelve")).click()
    expect(page.locator("dialog")).to_contain_text("Feed pump")
    send = page.locator("dialog button[type=submit]")
    expect(send).to_be_disabled()
    page.fill("dialog input", "ok")
    expect(send).to_be_disabled()
    page.fill("dialog input", "fan is being repaired")
    send.click()
    page.get_by_role("tab").nth(1).click()
    shelved = page.locator(".alarmrow", has_text="Feed pump").first
    expect(shelved).to_contain_text("shelved until")
    expect(shelved).to_contain_text(word("shelved_by", by="engineer", reason="fan is being repaired"))

    def records() -> list[Any]:
        return [one for one in stage.call("audit.list", drive="pump-2")["items"] if one["what"] == "alarm.shelve"]

    stage.wait(lambda: len(records()) == 2, "request and result are not recorded")
    recorded = records()[0]
    assert recorded["text"]["en"] == "Shelve alarm Feed pump · Fault: 60 min, reason: fan is being repaired"
    shelved.get_by_role("button", name=word("unshelve")).click()
    page.get_by_role("tab").first.click()
    expect(page.locator(".alarmrow", has_text="Feed pump").first).to_be_visible()


@pytest.fixture
def equal_alarms(stage: Stage) -> Iterator[None]:
    """Raise the same alarm on each drive of one bus, as a lost bus does."""
    fans = ("fan-1", "fan-2", "fan-3")
    plant, kind = stage.service.plant, SystemAlarm.FOREIGN_MASTER

    async def change(of: Callable[..., None]) -> None:
        for fan in fans:
            of(kind, fan, subject="fans")

    stage.do(lambda: change(plant.raise_alarm))
    yield
    stage.do(lambda: change(plant.clear_alarm))


@pytest.mark.usefixtures("equal_alarms")
def test_equal_alarms_are_one_row_that_opens_and_is_acknowledged_as_a_whole(
    stage: Stage, visit: Any, expect: Any
) -> None:
    trip(stage, "pump-2")
    page = visit("#/alarms", role="operator")
    group = page.locator(".alarmrow.group")
    title = i18n.text("alarms.title.foreign_master", "en")
    expect(group.locator("strong").first).to_have_text(word("alarm_group", title=title, n=3))
    expect(group.locator(".what").first).to_contain_text("Fan line: Extract fan, Flue gas fan, Supply fan")
    expect(group.locator(".when").first).to_contain_text(word("alarm_group_open", n=3))
    expect(page.locator(".alarms .alarms")).to_have_count(0)
    group.locator(".whole > summary").click()
    rows = group.locator(".alarms .alarmrow")
    expect(rows).to_have_count(3)
    rows.first.locator("summary").click()
    expect(rows.first).to_contain_text(i18n.text("alarms.remedy.foreign_master", "en"))
    group.locator("[data-alarm=acknowledge]").first.click()
    expect(group.locator(".when").first).to_contain_text(word("alarm_group_open", n=0))
    other = page.locator(".alarmrow", has_text="Feed pump").locator(".alarmstate").first
    expect(other).to_have_text(word("alarm_unacknowledged"))
    group.locator("[data-alarm=shelve]").click()
    expect(page.locator("dialog h2")).to_have_text(word("shelve_title_all", n=3))
    page.fill("dialog input", "second master is known")
    page.locator("dialog button[type=submit]").click()
    page.get_by_role("tab").nth(1).click()
    expect(group.locator(".when").first).to_contain_text(
        word("shelved_by", by="operator", reason="second master is known")
    )
    group.locator("[data-alarm=unshelve]").click()
    expect(group).to_have_count(0)
    deeds = [f"alarms.{deed}" for deed in ("unshelve", "shelve", "acknowledge") for _ in range(2)]

    def recorded() -> list[str]:
        return [item["what"] for item in stage.call("audit.list", drive="fan-1")["items"][:6]]

    stage.wait(lambda: recorded() == deeds, "request and result of each action are not recorded")


@pytest.mark.usefixtures("equal_alarms")
def test_the_banner_names_equal_alarms_once_and_acknowledges_them(stage: Stage, visit: Any, expect: Any) -> None:
    page = visit("#/fleet", role="operator")
    banner = page.locator(".banner.alarm")
    title = i18n.text("alarms.title.foreign_master", "en")
    expect(banner.locator("a").first).to_contain_text(f"{word('alarm_group', title=title, n=3)} · Fan line: ")
    banner.locator("[data-do=acknowledge]").click()
    expect(banner).to_have_count(0)
    assert [one for one in stage.call("alarms.list")["active"] if one["acknowledged_ms"] is None] == []


def test_past_alarms_are_listed_by_drive(stage: Stage, visit: Any, expect: Any) -> None:
    trip(stage, "pump-2")
    page = visit("#/alarms?tab=history", role="viewer")
    rows = page.locator(".alarms.past .alarmrow")
    expect(rows.first).to_be_visible()
    page.select_option(".filters select >> nth=1", "pump-2")
    expect(rows.first).to_contain_text("Feed pump")
    page.select_option(".filters select >> nth=1", "fan-2")
    expect(rows.filter(has_text="Feed pump")).to_have_count(0)


def test_a_viewer_may_neither_acknowledge_nor_shelve(stage: Stage, visit: Any, expect: Any) -> None:
    trip(stage, "pump-2")
    page = visit("#/alarms", role="viewer")
    expect(page.locator(".alarmrow").first).to_be_visible()
    assert page.locator(".alarmrow button").count() == 0


# --- audit --------------------------------------------------------------------------------------------------------


def test_the_audit_trail_shows_user_action_and_frames(stage: Stage, visit: Any, expect: Any) -> None:
    stage.call("drive.stop", drive="pump-1")
    page = visit("#/audit")
    page.fill(".filters input[type=search]", "drive.stop")
    entry = page.locator(".entry", has_text=word("outcome_confirmed")).filter(has_text="Circulation pump").first
    action = i18n.text("audit.on_drive_stop", subject="Circulation pump")
    expect(entry.locator(".what")).to_have_text(action)
    expect(entry.locator(".user")).to_have_text("tester")
    entry.locator("summary").click()
    expect(entry.locator("ol code").first).to_have_text(re.compile(r"([0-9A-F]{2} )+.* → ([0-9A-F]{2} ?)+"))
    row = f"tester {action} {word('outcome_confirmed')}"  # the text of the row
    page.fill(".filters input[type=search]", row)
    expect(page.locator(".entry").first.locator(".ended")).to_have_text(word("outcome_confirmed"))
    page.fill(".filters input[type=search]", row + " indeed")
    expect(page.locator(".entry")).to_have_count(0)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_result_that_changed_nothing_is_no_failure(stage: Stage, visit: Any, expect: Any, language: str) -> None:
    """Regression: it was an English word in red, in Chinese too."""
    stage.call("start_inhibits.release", drives=["fan-1"])
    stage.call("start_inhibits.release", drives=["fan-1"])
    page = visit("#/audit", language=language)
    newest = page.locator(".entry", has_text=i18n.text("audit.outcome_unchanged", language)).first.locator(".ended")
    expect(newest).not_to_have_class(re.compile("bad"))


def test_a_search_of_the_trail_without_a_match_says_so(stage: Stage, visit: Any, expect: Any) -> None:
    """Regression: an empty box stood there, above the number of all records."""
    stage.call("start_inhibit.release", drive="fan-1")
    page = visit("#/audit")
    page.locator(".entry").first.wait_for()
    none = page.locator("[role=status]", has_text=word("search_none"))
    assert none.count() == 0
    page.fill("main input[type=search]", "no record has this text")
    expect(none).to_be_visible()
    expect(page.locator(".audit")).to_be_hidden()


def test_a_command_is_one_row_with_its_value_and_shows_both_records_when_opened(
    stage: Stage, visit: Any, expect: Any
) -> None:
    stage.call("drive.set_frequency", drive="fan-3", frequency_hz=12.5)
    page = visit("#/audit")
    page.fill(".filters input[type=search]", "12.5 Hz")
    rows = page.locator(".entry")
    expect(rows.first.locator(".what")).to_have_text("Set the frequency of Flue gas fan: 12.5 Hz")
    expect(rows).to_have_count(1)
    expect(rows.locator(".ended")).to_have_text(word("outcome_acknowledged"))
    rows.locator("summary").click()
    request, result = (stage.call("audit.list", drive="fan-3")["items"][n] for n in (1, 0))
    shown = rows.locator("dl.facts")
    for record, of in ((request, 0), (result, 1)):
        time = datetime.fromtimestamp(record["time_ms"] / 1000, UTC).isoformat(timespec="milliseconds")
        expect(shown.nth(of)).to_contain_text(word("entry_n", n=record["n"]))
        expect(shown.nth(of)).to_contain_text(time.replace("+00:00", "Z"))
    assert (request["outcome"], result["of"]) == ("requested", request["n"])


def test_records_of_one_action_are_joined_by_the_number_of_the_request(visit: Any) -> None:
    """Changes of users name no request; a request whose result is not there yet stays a row."""
    page = visit("#/audit")
    numbers = page.evaluate(
        """async () => {
          const m = await import("/static/js/pages/audit.js");
          const record = (n, what, outcome, of = null) => ({ n, what, outcome, of, target: "x", who: { name: "ann" } });
          const entries = [record(9, "drive.run", "requested"), record(8, "user.add", "done"),
            record(7, "drive.stop", "failed", 4), record(6, "user.add", "requested"),
            record(5, "drive.stop", "confirmed"),
            record(4, "drive.stop", "requested"), record(3, "user.add", "requested")];
          return m.joinRecords(entries).map(({ entry, request }) => [entry.n, request?.n ?? null]);
        }"""
    )
    assert numbers == [[9, None], [8, 6], [7, 4], [5, None], [3, None]]


def test_a_label_of_several_faults_is_not_repeated_before_texts_that_have_each_of_them(visit: Any) -> None:
    """A VC660 with two fault bits: "bit 4 + bit 5" stood before "fault bit 4 …; fault bit 5 …"."""
    found = visit("#/fleet").evaluate(
        """async () => {
          const { namesFault, namesLabel } = await import("/static/js/drive/faults.js");
          const words = "fault bit 4, not published; fault bit 5, not published";
          const fault = (label) => ({ label, text: { en: words, zh: words } });
          return [namesLabel(fault("bit 4 + bit 5")), namesLabel(fault("bit 4 + bit 6")), namesLabel(fault("")),
            namesFault(`Fan reports a fault: ${words.slice(6)}`, fault("bit 4 + bit 5")),
            namesFault("Fan reports a fault: bit 4, not published", fault("bit 4 + bit 5")),
            namesFault(words, fault(null))];
        }"""
    )
    assert found == [True, False, True, True, False, True]


def test_the_chain_is_checked_from_the_page(visit: Any, expect: Any) -> None:
    page = visit("#/audit")
    page.click("[data-audit=verify]")
    expect(page.locator(".notice.good")).to_contain_text(word("audit_whole", n="").split(":")[0])


def test_an_operator_is_not_shown_the_trail(visit: Any, expect: Any) -> None:
    page = visit("#/audit", role="operator")
    expect(page.locator("main .notice")).to_have_text(word("no_right"))


# --- settings -----------------------------------------------------------------------------------------------------


def test_language_and_theme_are_chosen_and_stored(visit: Any, expect: Any) -> None:
    page = visit("#/settings", role="viewer")
    page.get_by_role("button", name="中文").last.click()
    expect(page.locator("h1")).to_have_text(i18n.text("page.nav_settings", "zh"))
    page.get_by_role("button", name=i18n.text("page.theme_dark", "zh"), exact=True).last.click()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("lang", "zh-CN")
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")


def test_an_administrator_adds_changes_and_removes_a_user(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=users", role="administrator")
    page.get_by_role("button", name=word("add_user")).click()
    fields = page.locator("dialog input")
    fields.nth(0).fill("nightshift")
    fields.nth(1).fill("a long enough pass phrase")
    page.locator("dialog button[type=submit]").click()
    row = page.locator("tr", has_text="nightshift")
    expect(row).to_contain_text(word("role_operator"))
    row.get_by_role("button").click()
    page.select_option("dialog select", "viewer")
    page.get_by_role("button", name=word("save_role")).click()
    expect(row).to_contain_text(word("role_viewer"))
    row.get_by_role("button").click()
    page.check("dialog input[type=checkbox]")
    page.get_by_role("button", name=word("remove_user"), exact=True).click()
    expect(row).to_have_count(0)


def test_a_reload_shows_what_it_applied(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=configuration", role="administrator")
    page.click("[data-configuration=compare]")
    page.check(".panel input[type=checkbox]")
    page.get_by_role("button", name=word("reload")).click()
    expect(page.locator(".notice.good")).to_contain_text(word("reloaded"))
    page.wait_for_timeout(500)  # the text of the file is loaded again meanwhile
    expect(page.locator(".notice.good")).to_contain_text(word("no_difference"))


def test_the_changes_that_a_reload_asks_to_have_read_are_those_of_the_file_as_it_is_now(
    stage: Stage, visit: Any, expect: Any
) -> None:
    """The box "I have read what would change" could be ticked with nothing to read beside it."""
    page = visit("#/settings?tab=configuration", role="administrator")
    box = page.locator(".panel input[type=checkbox]")
    panel = page.locator("section.panel").last
    expect(box).to_be_disabled()
    file = Path(stage.service.plant.config.source)
    before = file.read_text(encoding="utf-8")
    try:
        file.write_text(before.replace("Feed pump", "Boiler pump"), encoding="utf-8")  # after the page has read it
        page.click("[data-configuration=compare]")
        expect(panel.locator(".notice.good")).to_contain_text("pump-2")
        expect(box).to_be_enabled()
        file.write_text(before.replace('bus = "pumps"', 'bus = "pipes"'), encoding="utf-8")
        page.click("[data-configuration=compare]")
        expect(panel.locator(".notice.bad")).to_contain_text("pipes")
        box.check()  # the check may not read every profile that the reload may, so that its errors forbid nothing
        panel.locator(".button.main").click()
        expect(panel.locator(".notice.bad")).to_have_count(1)
        expect(panel.locator(".notice.bad")).not_to_contain_text(i18n.text("page.configuration_bad", "en", n=1))
        expect(panel.locator(".notice.bad")).to_contain_text("pipes")
        assert stage.view("pump-2")["bus"] == "pumps"
    finally:
        file.write_text(before, encoding="utf-8")


def test_a_reload_applies_nothing_where_the_file_has_changed_since_its_changes_were_read(
    stage: Stage, visit: Any, expect: Any
) -> None:
    """It applied the file as it was at the second click, whose changes no user had read."""
    page = visit("#/settings?tab=configuration", role="administrator")
    panel = page.locator("section.panel").last
    box = panel.locator("input[type=checkbox]")
    file = Path(stage.service.plant.config.source)
    before = file.read_text(encoding="utf-8")
    try:
        page.click("[data-configuration=compare]")
        box.check()
        file.write_text(before.replace("Feed pump", "Boiler pump"), encoding="utf-8")
        panel.locator(".button.main").click()
        expect(panel.locator(".notice.warning")).to_have_text(i18n.text("page.reload_outdated", "en"))
        expect(panel.locator(".notice.good")).to_contain_text("pump-2")
        expect(box).to_be_enabled()
        expect(box).not_to_be_checked()
        assert stage.view("pump-2")["title"]["en"] == "Feed pump"
        page.click("[data-configuration=compare]")
        expect(panel.locator(".notice.warning")).to_have_count(0)
    finally:
        file.write_text(before, encoding="utf-8")


def test_a_reload_that_moves_the_page_says_before_and_after_it_where_the_page_is_found(
    stage: Stage, visit: Any, expect: Any
) -> None:
    page = visit("#/settings?tab=configuration", role="administrator", language="zh")
    panel = page.locator("section.panel").last
    file = Path(stage.service.plant.config.source)
    before = file.read_text(encoding="utf-8")
    note = i18n.text("plant.gateway_moves", "zh", gateway="web", address="http://127.0.0.1:9090")
    back = i18n.text("plant.gateway_moves", "zh", gateway="web", address="http://127.0.0.1:8080")
    try:
        for text, expected in ((f"{before}\n[gateway.web]\nport = 9090\n", note), (before, back)):
            file.write_text(text, encoding="utf-8")
            page.click("[data-configuration=compare]")
            expect(panel.locator(".notice.good")).to_contain_text(expected)
            panel.locator("label.check").click()
            panel.locator(".button.main").click()
            expect(panel.locator(".notice.good")).to_contain_text(i18n.text("page.reloaded", "zh"))
            expect(panel.locator(".notice.good")).to_contain_text(expected)
    finally:
        file.write_text(before, encoding="utf-8")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_plant_that_is_too_large_for_the_check_is_reloaded_after_a_check_on_its_machine(
    stage: Stage, visit: Any, expect: Any, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    """The box of the reload could not be ticked, so that only the API reloaded the plant."""
    monkeypatch.setattr(configuration_check, "MAX_CHECKED_DRIVES", 4)
    page = visit("#/settings?tab=configuration", role="administrator", language=language)
    panel = page.locator("section.panel").last
    box, notice = panel.locator("label.check"), panel.locator(".notice.warning")
    page.click("[data-configuration=compare]")
    file = stage.service.plant.config.source
    for key, params in (("plant.check_too_many", {"found": 5, "most": 4}), ("page.reload_unseen", {"file": file})):
        expect(notice).to_contain_text(i18n.text(key, language, **params).replace("`", ""))
    expect(notice.locator("code")).to_have_text(["drivebus check FILE", f"drivebus check {file}"])
    expect(box).to_have_text(i18n.text("page.reload_sure_unseen", language).replace("`", ""))
    expect(box.locator("code")).to_have_text("drivebus check")
    box.click()
    panel.locator(".button.main").click()
    expect(panel.locator(".notice.good")).to_contain_text(i18n.text("page.reloaded", language))
    expect(notice).to_have_count(0)


def test_the_result_of_a_check_is_not_shown_beside_a_text_that_was_edited_meanwhile(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=configuration", role="administrator")
    held: list[Any] = []
    page.route("**/api/v1/configuration/check", lambda request: held.append(request), times=1)
    page.click("[data-configuration=check]")
    wait_until(page, lambda: bool(held), "the text is not sent")
    page.fill("textarea", "[plant")
    [request] = held
    with page.expect_response("**/api/v1/configuration/check"):
        request.continue_()
    page.wait_for_timeout(200)
    assert page.locator(".panel .notice").count() == 0
    page.click("[data-configuration=check]")
    expect(page.locator(".panel .notice.bad")).to_be_visible()


def test_a_changed_configuration_survives_a_look_at_another_page(visit: Any, expect: Any) -> None:
    """Regression: an engineer who followed an alarm lost the text that was not checked yet."""
    page = visit("#/settings?tab=configuration", role="administrator")
    text = page.input_value("textarea")
    page.fill("textarea", "[plant")
    page.evaluate("location.hash = '#/alarms'")
    page.locator("textarea").wait_for(state="detached")
    page.go_back()
    expect(page.locator("textarea")).to_have_value("[plant")
    page.locator("button", has_text=i18n.text("page.back_to_file", "en")).click()
    page.evaluate("location.hash = '#/alarms'")
    page.locator("textarea").wait_for(state="detached")
    page.go_back()
    expect(page.locator("textarea")).to_have_value(text)


def test_the_way_back_from_a_drive_leads_to_the_place_where_the_fleet_was_left(visit: Any) -> None:
    """Regression: after a look at one of many drives the fleet began at its top again."""
    page = visit("#/fleet", size=(360, 560))
    last = page.locator(".tilelink").last
    last.wait_for()
    last.scroll_into_view_if_needed()
    page.evaluate(DRAWN)
    place = page.evaluate("scrollY")
    assert place > 100
    for _ in range(2):
        last.click()
        page.locator(".drivehead").wait_for()
        page.wait_for_function("() => scrollY === 0")
        page.evaluate("scrollTo(0, 200)")
        page.evaluate(DRAWN)
        page.go_back()
        page.wait_for_function("(left) => Math.abs(scrollY - left) < 3", arg=place)
    page.go_forward()
    page.wait_for_function("() => scrollY === 200")
    page.locator(".drivehead a").first.click()
    last.wait_for()
    page.wait_for_function("() => scrollY === 0")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_unknown_address_leads_to_the_fleet(visit: Any, expect: Any, language: str) -> None:
    """Regression: an outdated bookmark ended at a sentence without a next step."""
    page = visit("#/bus/fans", language=language)
    notice = page.locator(".notice", has_text=i18n.text("page.no_such_page", language))
    notice.locator("a").click()
    expect(page.locator(".tile").first).to_be_visible()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_dialog_and_the_record_of_a_shelved_bus_alarm_name_the_bus(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """Regression: both said "Port lost" and did not name the port."""
    plant = stage.service.plant

    async def change(of: Callable[..., None], **params: str) -> None:
        of(SystemAlarm.PORT_LOST, subject="pumps", **params)

    stage.do(lambda: change(plant.raise_alarm, reason="unplugged"))
    try:
        page = visit("#/alarms", language=language)
        name = {"en": "Pump line", "zh": "水泵线路"}[language]
        row = page.locator(".alarmrow", has_text=name).first
        row.get_by_role("button", name=i18n.text("page.shelve", language)).click()
        title = i18n.text("alarms.title.port_lost", language)
        expect(page.locator("dialog")).to_contain_text(title + i18n.text("page.colon", language) + name)
        page.fill("dialog input", "adapter")
        page.click("dialog button[type=submit]")
        expect(page.locator("dialog")).to_have_count(0)
        newest = next(one for one in stage.call("audit.list")["items"] if one["what"] == "alarm.shelve")
        assert f"{name} · {title}" in newest["text"][language]
        stage.call("alarm.unshelve", alarm=newest["target"])
    finally:
        stage.do(lambda: change(plant.clear_alarm))


@pytest.mark.parametrize("language", ["en", "zh"])
def test_on_a_phone_a_date_of_a_table_is_not_broken_at_its_hyphens(stage: Stage, visit: Any, language: str) -> None:
    trip(stage, "fan-3")
    page = visit("#/fleet", language=language, role="administrator", size=(360, 740))
    broken = {}
    for way in ("drive/fan-3?tab=faults", "settings", "settings?tab=users"):
        page.locator("td.time").evaluate_all("all => all.forEach((one) => one.classList.remove('time'))")
        page.evaluate("way => { location.hash = '#/' + way; }", way)
        page.locator("td.time").first.wait_for()  # of the new page: those of the old one are no longer found
        heights = page.locator("td.time").evaluate_all(TEXT_LINES)
        broken[way] = [lines for lines in heights if lines > 2]
    assert broken == {way: [] for way in broken}


TEXT_LINES = """all => all.map((one) => {
  const range = document.createRange();
  range.selectNodeContents(one);
  return new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size;
})"""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_cell_of_the_parameters_of_a_drive_is_cut_off_on_a_phone(stage: Stage, visit: Any, language: str) -> None:
    """Value, range and the field of a change were beyond the right edge of a table of ten columns."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1?tab=parameters", size=(360, 740), language=language)
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    page.click("[data-do=read]")
    page.locator(".stacks td b").first.wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    row = page.locator(".stacks tbody tr", has=page.locator("td input")).first
    name, field, read = (
        row.locator(where).bounding_box() for where in ("td.key code", "td input", "td.corner .button")
    )
    assert name["y"] + name["height"] <= field["y"]
    assert name["x"] + name["width"] <= read["x"] and read["y"] < field["y"]


def test_the_field_of_a_parameter_stays_in_sight_while_its_table_scrolls(stage: Stage, visit: Any) -> None:
    """It was the last of ten columns, beyond the right edge of a panel that a screen of 1440 pixels gives 800."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1?tab=parameters", size=(1024, 768))
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    edge, field = (page.locator(where).first.bounding_box() for where in (".drivedetails .scroll", "td input"))
    assert field["x"] + field["width"] <= edge["x"] + edge["width"] + 1


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_table_of_parameters_fits_a_screen_of_1280_pixels_and_with_its_fields_one_of_1440(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: the column of the fields, which stays in sight, covered that of the ranges.

    At 1280 pixels the buttons that read a parameter were beyond the right edge.
    """
    page = visit("#/drive/pump-1?tab=parameters", size=(1280, 800), language=language)
    page.locator(".drivedetails td").first.wait_for()
    table, beyond = page.locator(".drivedetails .scroll"), "(table) => table.scrollWidth - table.clientWidth"
    assert table.evaluate(beyond) <= 0
    page.set_viewport_size({"width": 1440, "height": 900})
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    page.click("[data-do=read]")
    page.locator(".drivedetails td b").first.wait_for()
    assert table.evaluate(beyond) <= 0


def test_no_cell_of_the_stations_of_a_bus_is_cut_off_on_a_phone(visit: Any, expect: Any) -> None:
    """Seven of nine columns were beyond the right edge, and their sentences made the rows tall."""
    page = visit("#/buses/fans", size=(360, 740))
    expect(page.locator(".stacks tbody tr")).to_have_count(3)
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    nodes = [node.bounding_box() for node in page.locator(".cable li").all()]
    assert len({box["y"] for box in nodes[:3]}) == 1


def test_a_fault_without_a_label_has_a_dash_in_its_place(visit: Any, expect: Any) -> None:
    page = visit("#/models/vc660?tab=faults")
    fault = page.get_by_role("region", name=word("all_faults")).locator("tbody tr").first
    expect(fault).to_contain_text("under-voltage")
    assert "" not in [one.strip() for one in fault.locator("td").all_inner_texts()]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("way", ["models", "models/c320"])
def test_no_cell_of_the_models_and_of_their_signals_is_cut_off_on_a_phone(
    visit: Any, expect: Any, way: str, language: str
) -> None:
    """Regression: encodings, settings and what a model can't do were beyond the right edge."""
    page = visit(f"#/{way}", size=(390, 844), language=language)
    expect(page.locator(".stacks tbody tr").nth(2)).to_be_visible()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    wide = page.locator("main .scroll").evaluate_all(
        "(all) => all.filter((one) => one.scrollWidth > one.clientWidth).length"
    )
    assert wide == 0


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", [(390, 844), (683, 384)], ids=["phone", "zoomed to 200 %"])
def test_the_reason_of_a_missing_value_of_a_tripped_drive_is_not_cut_off(
    stage: Stage, visit: Any, expect: Any, size: tuple[int, int], language: str
) -> None:
    """Regression: its end was cut off, and only a mouse could show it."""
    trip(stage, "fan-3")
    page = visit("#/drive/fan-3", size=size, language=language)
    reason = i18n.text("drives.item_not_echoed", language)
    shown = page.locator(".values .reason span", has_text=reason)
    expect(shown.first).to_be_visible()
    cut = shown.evaluate_all("(all) => all.filter((one) => one.scrollHeight > one.clientHeight + 2).length")
    assert cut == 0


def test_a_token_is_shown_once_and_opens_the_api(stage: Stage, visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=tokens", role="engineer")
    page.get_by_role("button", name=word("add_token")).click()
    page.fill("dialog input >> nth=0", "trend reader")
    page.locator("dialog button[type=submit]").click()
    secret = page.locator("code.secret").inner_text()
    bearer = {"Authorization": f"Bearer {secret}"}
    apart = page.context.browser.new_context()
    try:
        assert apart.request.get(f"{stage.at}/api/v1/drives", headers=bearer).ok
        page.reload()
        row = page.locator("tr", has_text="trend reader")
        expect(row).to_be_visible()
        assert page.locator("code.secret").count() == 0
        row.get_by_role("button").click()
        row.get_by_role("button").click()
        expect(row).to_have_count(0)
        assert apart.request.get(f"{stage.at}/api/v1/drives", headers=bearer).status == 401
    finally:
        apart.close()


@pytest.mark.parametrize("tab", ["users", "tokens"])
def test_the_actions_of_a_row_are_visible_on_a_phone(stage: Stage, visit: Any, tab: str) -> None:
    page = visit(f"#/settings?tab={tab}", role="administrator", size=(360, 740))
    if tab == "tokens":
        page.click(".panel .button.main")
        page.fill("dialog input >> nth=0", "history")
        page.click("dialog button[type=submit]")
    act = page.locator("td.act .button").first
    act.wait_for()
    edge = page.locator(".panel .scroll").bounding_box()
    box = act.bounding_box()
    assert box["x"] + box["width"] <= edge["x"] + edge["width"] <= 360


def test_two_chinese_sentences_of_a_field_have_no_space_between_them(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=users", role="administrator", language="zh")
    page.click(".panel .button.main")
    help = page.locator("dialog .field .help").last
    expect(help).to_contain_text(i18n.text("page.first_password_help", "zh"))
    assert "。 " not in help.inner_text()


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("tab", ["users", "tokens", "me"])
def test_no_cell_of_a_users_tables_is_cut_off_on_a_phone(visit: Any, tab: str, language: str) -> None:
    """The end of a token's validity was behind the button that removes it."""
    page = visit(f"#/settings?tab={tab}", role="administrator", size=(375, 812), language=language)
    if tab == "tokens":
        page.click(".panel .button.main")
        page.fill("dialog input >> nth=0", "history-of-the-boiler-house")
        for box in page.locator("dialog input[type=checkbox]").all():
            box.check()
        page.click("dialog button[type=submit]")
    page.locator(".stacks td.act .button").first.wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    titles = page.locator(".stacks tbody tr").first.locator("td").evaluate_all(TITLES_OF_CELLS)
    heads = page.locator(".stacks thead th").all_text_contents()
    assert titles == ["none", *(f'"{head}"' for head in heads[1:-1]), "none"]


def test_nothing_of_an_incident_is_beyond_the_edge_of_a_phone(stage: Stage, visit: Any) -> None:
    """The meaning of a frame, the value of a parameter, and whether a drive was online, were beyond the right edge."""
    trip(stage, "fan-3")
    page = visit("#/alarms?tab=incidents", size=(360, 740))
    page.locator(".incidents a").first.click()
    for title in ("incident_states", "incident_parameters", "frames_title"):
        page.get_by_role("region", name=word(title)).locator("tbody td").nth(3).wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    beyond = "(tables) => tables.map((one) => one.scrollWidth - one.clientWidth)"
    assert max(page.locator("main .scroll").evaluate_all(beyond)) <= 0
    head = page.get_by_role("region", name=word("incident_parameters")).locator("thead")
    assert word("wire_address") in head.inner_text(), "another word than in the parameters of a drive"


CELLS_OUT_OF_PLACE = """() => [...document.querySelectorAll(".stacks td")].filter((cell) => {
  const [box, edge] = [cell, cell.closest(".panel")].map((one) => one.getBoundingClientRect());
  if (box.width === 0) return false; // an empty cell is not shown
  const titleHeight = parseFloat(getComputedStyle(cell, "::before").height);
  const isWide = box.left < edge.left || box.right > edge.right || cell.scrollWidth > cell.clientWidth;
  return isWide || titleHeight > box.height;
}).map((cell) => cell.textContent)"""
TITLES_OF_CELLS = "(cells) => cells.map((cell) => getComputedStyle(cell, '::before').content)"


def test_a_user_ends_another_session_and_this_one(visit: Any, expect: Any) -> None:
    lost = visit("#/fleet", role="operator")
    page = visit("#/settings", role="operator")
    rows = page.locator("section.panel").last.locator("tbody tr")
    others = rows.filter(has_not_text=word("this_session"))
    others.first.wait_for()
    for row in (others.last, rows.filter(has_text=word("this_session"))):
        row.get_by_role("button").click()
        page.fill("dialog input", PASSWORD)
        page.locator("dialog button[type=submit]").click()
        page.locator("dialog").wait_for(state="detached")
    for one in (page, lost):
        expect(one.get_by_role("button", name=word("log_in"), exact=True)).to_be_visible()
        expect(one.locator("[data-text=session-ended]")).to_contain_text(i18n.text("auth.closed.logout", "en"))
    log_in(lost, "operator")
    lost.get_by_role("button", name=word("log_out")).click()
    expect(lost.get_by_role("button", name=word("log_in"), exact=True)).to_be_visible()
    expect(lost.locator("[data-text=session-ended]")).to_have_count(0)


def test_a_password_is_changed_with_the_current_one(visit: Any, expect: Any) -> None:
    page = visit("#/settings", role="viewer")
    old, new, again = (page.locator("input[type=password]").nth(n) for n in range(3))
    old.fill(PASSWORD)
    new.fill("another correct horse")
    again.fill("another correct hoarse")
    button = page.get_by_role("button", name=word("change_password"))
    expect(button).to_be_disabled()
    again.fill("another correct horse")
    button.click()
    expect(page.locator(".notice.good")).to_have_text(word("password_changed"))
    for field, text in ((old, "another correct horse"), (new, PASSWORD), (again, PASSWORD)):
        field.fill(text)
    button.click()
    expect(old).to_have_value("")
