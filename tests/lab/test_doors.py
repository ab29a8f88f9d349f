"""The campaign of strangers sees a door that is open (G21)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivebus.lab.campaign import Session, find, perform
from drivebus.plant.access.sessions import Session as Browser
from drivebus.web.door import Guard
from drivebus.web.hosts import Hosts


def nothing(*_: Any, **__: Any) -> None:
    """The check is gone."""


def everybody(*_: Any, **__: Any) -> bool:
    return True


DOORS: dict[str, tuple[type, str, Callable[..., Any]]] = {
    "rights are not asked for": (Guard, "_check_right", nothing),
    "a cookie is enough": (Guard, "_check_same_site", nothing),
    "any page may open a connection": (Hosts, "origin_fits", everybody),
    "sessions never grow old": (Browser, "age", nothing),
}


@pytest.mark.parametrize("door", DOORS)
def test_g21_strangers_come_in_where_the_door_is_open(door: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, instead = DOORS[door]
    monkeypatch.setattr(owner, name, instead)
    session = perform(find("doors"), Session("doors", 3, 2000))
    assert session.violated > 0
