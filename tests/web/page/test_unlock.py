"""Idle sessions on the page: they can view and stop, the password restores the other rights, and leases stay."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S
from fixtures.browser import Stage
from fixtures.web_app import PASSWORD


def fall_idle(stage: Stage) -> None:
    """Let the sessions of the operator become idle."""
    for session in stage.access.sessions.of_user("operator"):
        session.active -= SESSION_IDLE_TIMEOUT_S


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_idle_page_can_stop_and_its_password_unlocks_it(stage: Stage, visit: Any, language: str) -> None:
    page = visit("#/drive/fan-1", language=language, role="operator")
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")
    fall_idle(stage)
    page.reload()
    page.wait_for_selector("[data-do=unlock]")
    assert page.locator("[data-step=first]:enabled").count() == 0
    assert page.locator(".stopbar button:enabled").count() > 0

    page.fill("[data-do=unlock] input[type=password]", PASSWORD)
    page.click("[data-do=unlock] button")
    page.wait_for_selector("[data-do=unlock]", state="detached")
    page.wait_for_selector(".lease.own")
