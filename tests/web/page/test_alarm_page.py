"""Page of the alarms: acknowledged, shelved, grouped where they are equal, and listed when they are past."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.alarms import SystemAlarm
from fixtures.browser import Stage
from fixtures.browser_actions import page_text, trip


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


def test_on_a_small_desktop_the_sentence_of_an_alarm_has_more_room_than_its_buttons(stage: Stage, visit: Any) -> None:
    """Regression: it stood in a column of 144 px beside an empty place of 280 px."""
    trip(stage, "pump-2")
    page = visit("#/alarms", size=(1024, 768))
    row = page.locator(".alarmrow", has_text="Feed pump").first
    sentence, buttons = (row.locator(part).bounding_box() for part in (".what", ".do"))
    assert sentence["width"] > buttons["width"]


def test_an_alarm_is_shelved_with_a_reason_and_taken_back(stage: Stage, visit: Any, expect: Any) -> None:
    trip(stage, "pump-2")
    page = visit("#/alarms")
    row = page.locator(".alarmrow", has_text="Feed pump").first
    row.get_by_role("button", name=page_text("shelve")).click()
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
    expect(shelved).to_contain_text(page_text("shelved_by", by="engineer", reason="fan is being repaired"))

    def records() -> list[Any]:
        return [entry for entry in stage.call("audit.list", drive="pump-2")["items"] if entry["what"] == "alarm.shelve"]

    stage.wait(lambda: len(records()) == 2, "request and result are not recorded")
    recorded = records()[0]
    assert recorded["text"]["en"] == "Shelve alarm Feed pump · Fault: 60 min, reason: fan is being repaired"
    shelved.get_by_role("button", name=page_text("unshelve")).click()
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
    expect(group.locator("strong").first).to_have_text(page_text("alarm_group", title=title, n=3))
    expect(group.locator(".what").first).to_contain_text("Fan line: Extract fan, Flue gas fan, Supply fan")
    expect(group.locator(".when").first).to_contain_text(page_text("alarm_group_open", n=3))
    expect(page.locator(".alarms .alarms")).to_have_count(0)
    group.locator(".whole > summary").click()
    rows = group.locator(".alarms .alarmrow")
    expect(rows).to_have_count(3)
    rows.first.locator("summary").click()
    expect(rows.first).to_contain_text(i18n.text("alarms.remedy.foreign_master", "en"))
    group.locator("[data-alarm=acknowledge]").first.click()
    expect(group.locator(".when").first).to_contain_text(page_text("alarm_group_open", n=0))
    other = page.locator(".alarmrow", has_text="Feed pump").locator(".alarmstate").first
    expect(other).to_have_text(page_text("alarm_unacknowledged"))
    group.locator("[data-alarm=shelve]").click()
    expect(page.locator("dialog h2")).to_have_text(page_text("shelve_title_all", n=3))
    page.fill("dialog input", "second master is known")
    page.locator("dialog button[type=submit]").click()
    page.get_by_role("tab").nth(1).click()
    expect(group.locator(".when").first).to_contain_text(
        page_text("shelved_by", by="operator", reason="second master is known")
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
    expect(banner.locator("a").first).to_contain_text(f"{page_text('alarm_group', title=title, n=3)} · Fan line: ")
    banner.locator("[data-do=acknowledge]").click()
    expect(banner).to_have_count(0)
    assert [alarm for alarm in stage.call("alarms.list")["active"] if alarm["acknowledged_ms"] is None] == []


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
        newest = next(entry for entry in stage.call("audit.list")["items"] if entry["what"] == "alarm.shelve")
        assert f"{name} · {title}" in newest["text"][language]
        stage.call("alarm.unshelve", alarm=newest["target"])
    finally:
        stage.do(lambda: change(plant.clear_alarm))


def test_no_line_of_a_past_alarm_ends_within_a_date(stage: Stage, visit: Any, expect: Any) -> None:
    """Regression: "acknowledged by engineer, 2026-11-" stood in one line and "30 02:05:45" in the next."""
    trip(stage, "pump-2")
    for alarm in stage.uncleared_faults():
        stage.call("alarm.acknowledge", alarm=alarm["id"])
    page = visit("#/alarms")
    page.get_by_role("tab").nth(2).click()
    row = page.locator(".alarms.past .alarmrow", has_text="Feed pump").first
    dates = row.locator(".when .whole-number")
    expect(dates).to_have_count(2)
    for width in range(1100, 1500, 25):
        page.set_viewport_size({"width": width, "height": 900})
        assert dates.evaluate_all("all => all.map((one) => one.getClientRects().length)") == [1, 1], width
