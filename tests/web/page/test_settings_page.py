"""Page of the settings: language and theme, own sessions and password, users and tokens."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.runtime import supervision
from fixtures.browser import Stage, log_in
from fixtures.browser_actions import page_text
from fixtures.web_app import PASSWORD


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
    page.get_by_role("button", name=page_text("add_user")).click()
    fields = page.locator("dialog input")
    fields.nth(0).fill("nightshift")
    fields.nth(1).fill("a long enough pass phrase")
    page.locator("dialog button[type=submit]").click()
    row = page.locator("tr", has_text="nightshift")
    expect(row).to_contain_text(page_text("role_operator"))
    row.get_by_role("button").click()
    page.select_option("dialog select", "viewer")
    page.get_by_role("button", name=page_text("save_role")).click()
    expect(row).to_contain_text(page_text("role_viewer"))
    row.get_by_role("button").click()
    page.check("dialog input[type=checkbox]")
    page.get_by_role("button", name=page_text("remove_user"), exact=True).click()
    expect(row).to_have_count(0)


def test_a_token_is_shown_once_and_opens_the_api(stage: Stage, visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=tokens", role="engineer")
    page.get_by_role("button", name=page_text("add_token")).click()
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


def test_two_chinese_sentences_of_a_field_have_no_space_between_them(visit: Any, expect: Any) -> None:
    page = visit("#/settings?tab=users", role="administrator", language="zh")
    page.click(".panel .button.main")
    help = page.locator("dialog .field .help").last
    expect(help).to_contain_text(i18n.text("page.first_password_help", "zh"))
    assert "。 " not in help.inner_text()


def test_a_user_ends_another_session_and_this_one(visit: Any, expect: Any) -> None:
    lost = visit("#/fleet", role="operator")
    page = visit("#/settings", role="operator")
    rows = page.locator("section.panel").last.locator("tbody tr")
    others = rows.filter(has_not_text=page_text("this_session"))
    others.first.wait_for()
    for row in (others.last, rows.filter(has_text=page_text("this_session"))):
        row.get_by_role("button").click()
        page.fill("dialog input", PASSWORD)
        page.locator("dialog button[type=submit]").click()
        page.locator("dialog").wait_for(state="detached")
    for tab in (page, lost):
        expect(tab.get_by_role("button", name=page_text("log_in"), exact=True)).to_be_visible()
        expect(tab.locator("[data-text=session-ended]")).to_contain_text(i18n.text("auth.closed.logout", "en"))
    log_in(lost, "operator")
    lost.get_by_role("button", name=page_text("log_out")).click()
    expect(lost.get_by_role("button", name=page_text("log_in"), exact=True)).to_be_visible()
    expect(lost.locator("[data-text=session-ended]")).to_have_count(0)


def test_a_password_is_changed_with_the_current_one(visit: Any, expect: Any) -> None:
    page = visit("#/settings", role="viewer")
    old, new, again = (page.locator("input[type=password]").nth(n) for n in range(3))
    old.fill(PASSWORD)
    new.fill("another correct horse")
    again.fill("another correct hoarse")
    button = page.get_by_role("button", name=page_text("change_password"))
    expect(button).to_be_disabled()
    again.fill("another correct horse")
    button.click()
    expect(page.locator(".notice.good")).to_have_text(page_text("password_changed"))
    for field, text in ((old, "another correct horse"), (new, PASSWORD), (again, PASSWORD)):
        field.fill(text)
    button.click()
    expect(old).to_have_value("")


@pytest.mark.parametrize("synchronized", [True, False])
def test_about_says_whether_the_clock_is_synchronized(
    stage: Stage, visit: Any, expect: Any, synchronized: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervision, "is_clock_synchronized", lambda: synchronized)
    stage.service.plant.clock_synchronized = synchronized
    page = visit("#/settings?tab=about")
    expect(page.locator("dt", has_text=page_text("about_clock")).locator("+ dd")).to_have_text(
        page_text(f"about_clock_{str(synchronized).lower()}")
    )
