"""The campaign of strangers sees a door that is open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivebus.service.auth.sessions import Session as Browser
from drivebus.web.middleware.auth import AuthMiddleware
from drivebus.web.middleware.host_check import HostCheck
from verification.campaign import CampaignRun, load_campaign, run_campaign


def no_check(*_: Any, **__: Any) -> None:
    """The check is gone."""


def any_user(*_: Any, **__: Any) -> bool:
    return True


OPENED_CHECKS: dict[str, tuple[type, str, Callable[..., Any]]] = {
    "rights are not asked for": (AuthMiddleware, "_check_right", no_check),
    "a cookie is enough": (AuthMiddleware, "_check_csrf", no_check),
    "any page may open a connection": (HostCheck, "is_allowed_origin", any_user),
    "sessions never grow old": (Browser, "expire", no_check),
}


@pytest.mark.parametrize("door", OPENED_CHECKS)
def test_strangers_come_in_where_the_door_is_open(door: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, instead = OPENED_CHECKS[door]
    monkeypatch.setattr(owner, name, instead)
    session = run_campaign(load_campaign("doors"), CampaignRun("doors", 3, 2000))
    assert session.violation_count > 0
