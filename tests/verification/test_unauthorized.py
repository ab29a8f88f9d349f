"""The campaign ``unauthorized`` finds each check of the web app that is missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivebus.service.auth.sessions import Session
from drivebus.web.middleware.auth import AuthMiddleware
from drivebus.web.middleware.host_check import HostCheck
from fixtures.campaigns import finds


def no_check(*_: Any, **__: Any) -> None:
    """Stand in for a check that is missing."""


def accept_all(*_: Any, **__: Any) -> bool:
    return True


MISSING_CHECKS: dict[str, tuple[type, str, Callable[..., Any]]] = {
    "no rights required": (AuthMiddleware, "_check_right", no_check),
    "no CSRF token required": (AuthMiddleware, "_check_csrf", no_check),
    "any origin allowed": (HostCheck, "is_allowed_origin", accept_all),
    "sessions never expire": (Session, "expire", no_check),
}


@pytest.mark.parametrize("check", MISSING_CHECKS)
def test_a_missing_check_is_found(check: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement = MISSING_CHECKS[check]
    monkeypatch.setattr(owner, name, replacement)
    assert finds("unauthorized", "", 4000)
