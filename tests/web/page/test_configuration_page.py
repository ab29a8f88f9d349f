"""Configuration on the page: edited, checked, compared with the plant, and reloaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.runtime import configuration_check
from fixtures.browser import Stage
from fixtures.browser_actions import page_text, wait_until


def test_a_reload_shows_what_it_applied(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=configuration", role="administrator")
    page.click("[data-configuration=compare]")
    page.check(".panel input[type=checkbox]")
    page.get_by_role("button", name=page_text("reload")).click()
    expect(page.locator(".notice.good")).to_contain_text(page_text("reloaded"))
    page.wait_for_timeout(500)  # the text of the file is loaded again meanwhile
    expect(page.locator(".notice.good")).to_contain_text(page_text("no_difference"))


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
