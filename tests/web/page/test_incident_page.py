"""Incidents on the page: their list, states, parameters, frames and notes."""

from __future__ import annotations

import time
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import page_text, resize, trip


def test_an_alarm_is_acknowledged_and_its_incident_opened(stage: Stage, visit: Any, expect: Any) -> None:
    charted = ("output_frequency", "dc_bus_voltage", "output_voltage")
    stage.wait(
        lambda: all(stage.view("fan-3")["signals"][name]["value"] is not None for name in charted),
        "a plant that has just begun has not read every signal",
    )
    trip(stage, "fan-3")
    page = visit("#/alarms", role="operator")
    row = page.locator(".alarmrow", has_text="Flue gas fan").first
    expect(row.locator(".alarmstate")).to_have_text(page_text("alarm_unacknowledged"))
    row.locator("[data-alarm=acknowledge]").click()
    expect(row.locator(".alarmstate")).to_have_text(page_text("alarm_acknowledged"))
    row.get_by_role("link", name=page_text("open_incident")).click()
    expect(page.locator("h1")).to_contain_text("Flue gas fan")
    expect(page.locator(".notice.bad").first).to_contain_text("Flue gas fan")
    expect(page.locator(".trend-plot canvas")).to_be_visible()
    expect(page.locator(".trend-readout tbody tr").first).to_contain_text("output frequency")
    shown = page.locator(".trend-readout tbody tr:not(.off) th").all_inner_texts()
    assert shown == [i18n.text(f"signal.{name}", "en") for name in charted]
    frames = page.get_by_role("region", name=page_text("frames_title"))
    assert frames.locator("tbody tr").count() > 20
    with page.expect_download() as saved:
        page.get_by_role("button", name=page_text("save_capture")).click()
    assert saved.value.suggested_filename.endswith(".dbcap") and saved.value.path().stat().st_size > 200
    page.locator(".notes input").fill("bearing exchanged")
    page.locator(".notes button[type=submit]").click()
    expect(page.locator(".notes li")).to_contain_text(["bearing exchanged"])
    expect(page.locator(".notes li b")).to_have_text("operator")
    page.route("**/api/v1/incidents/*", unread)
    page.reload()
    parameters = page.get_by_role("region", name=page_text("incident_parameters")).locator("tbody tr")
    expect(parameters.filter(has_text="F9.4")).to_contain_text(i18n.text("drives.no_answer", "en"))
    expect(page.locator(".notice.warning")).to_contain_text(UNREAD_CAPTURE["en"])
    assert not page.get_by_role("button", name=page_text("save_capture")).is_visible()


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
def test_a_parameter_that_is_read_during_a_fault_is_shown_as_uncertain_with_its_reason(
    stage: Stage, visit: Any, expect: Any, language: str
) -> None:
    """Regression: in the incident and on the drive's page it looked like any other value."""
    trip(stage, "fan-3")
    note = i18n.text("page.quality_uncertain", language) + i18n.text("page.colon", language)
    note += i18n.text("drives.item_not_echoed", language)
    for address, read in (
        ("#/drive/fan-3?tab=parameters", "[data-do=read]"),
        ("#/alarms?tab=incidents", ".incidents a"),
    ):
        page = visit(address, language=language, size=(360, 740))
        page.locator(read).first.click()
        row = page.locator("tr", has=page.locator("code:text-is('F0.1')"))
        expect(row.locator(".doubtful")).to_have_text(note)
        for width in (360, 1440):
            resize(page, width, 740)
            expect(row.locator(".doubtful")).to_be_visible()
            assert page.evaluate("document.documentElement.scrollWidth") <= width


UNREAD_CAPTURE = {"en": "the frames cannot be read", "zh": "无法读取报文"}


def unread(route: Any) -> None:
    """Answer with an incident whose parameters could not be read, nor the file of its frames."""
    answer = route.fetch()
    silent = {"raw": None, "value": None, "unit": "", "quality": "bad", "reason": "drives.no_answer"}
    found = {"parameters": {"F9.4": silent}, "capture": None, "capture_problem": UNREAD_CAPTURE}
    route.fulfill(response=answer, json=answer.json() | found)


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
