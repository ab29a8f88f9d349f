"""Coming in: the first start, an address that logs in once, a wrong password, and what an idle hand may do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.auth.users import UserDatabase
from fixtures.browser import Stage
from fixtures.web_app import PASSWORD, USERS


@pytest.fixture
def nobody(stage: Stage) -> Iterator[Stage]:
    """A plant that was never set up."""
    stage.access.user_file.change(lambda _: UserDatabase())
    yield stage
    stage.access.user_file.change(lambda _: USERS)


def test_the_first_start_takes_the_printed_secret_and_makes_the_administrator(nobody: Stage, visit: Any) -> None:
    """There is no password that anybody could know."""
    page = visit("#/fleet", role=None)
    page.fill("input[name=secret]", nobody.access.setup_secret.issue())
    page.fill("input[name=name]", "ada")
    page.fill("input[name=password]", "a quite long sentence")
    page.click("button[type=submit]")
    page.locator(".line.live").wait_for()
    assert page.locator(".user").inner_text() == "ada"
    assert [user.name for user in nobody.access.database.users] == ["ada"]


def test_an_address_logs_in_once_and_forgets_its_code(stage: Stage, visit: Any) -> None:
    """The code leaves the address bar at once, and works no second time."""
    code = stage.do(lambda: stage.access.issue_code("operator", 60.0))
    page = visit(f"#login={code}", role=None)
    page.locator(".line.live").wait_for()
    assert code not in page.url and page.locator(".user").inner_text() == "operator"
    again = visit(f"#login={code}", role=None)
    again.locator("input[name=password]").wait_for()
    again.locator(f".notice.bad:has-text('{i18n.text('auth.wrong_code', 'en')}')").wait_for()
    assert code not in again.url


def test_a_wrong_password_is_told_and_nothing_is_shown(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet", role=None)
    page.fill("input[name=name]", "operator")
    page.fill("input[name=password]", PASSWORD + "?")
    page.click("button[type=submit]")
    page.locator(f".notice.bad:has-text('{i18n.text('auth.wrong_password', 'en')}')").wait_for()
    assert page.locator(".tile, .stopbar").count() == 0


def test_an_idle_hand_only_stops_until_it_gives_its_password_again(stage: Stage, visit: Any) -> None:
    """The rights to control sleep, the right to stop never does."""
    page = visit("#/drive/fan-1", role="operator")
    page.locator("[data-do=take]:enabled").wait_for()
    for session in stage.access.sessions.of_user("operator"):
        session.active -= 3600.0
    page.evaluate("import('/static/js/session.js').then((m) => m.loadSession())")
    page.locator("form[data-do=wake]").wait_for()
    assert page.locator("[data-do=take]:enabled").count() == 0
    page.click("[data-stop=drive]")
    page.locator(".told.good").wait_for()
    page.fill("form[data-do=wake] input[type=password]", PASSWORD)
    page.click("form[data-do=wake] button")
    page.locator("[data-do=take]:enabled").wait_for()
