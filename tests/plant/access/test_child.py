"""How the plant starts its web process, and what that process understands of it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.plant.access.child import command, understood
from drivebus.plant.access.offline import file_of
from drivebus.plant.model import WebSetting
from plantkit import setting

WEB = WebSetting("::", 8443, Path("/c.pem"), Path("/k.pem"), ("https://plant.example",))
SOCKET = Path("/state/plant.sock")


def test_the_web_process_understands_what_the_plant_tells_it() -> None:
    chosen = setting(directory=Path("/state"), web=WEB)
    words = command(chosen, SOCKET)
    assert words[:3] == [sys.executable, "-m", "drivebus.web"]
    path, child = understood(words[3:])
    assert (path, child.directory, child.web) == (SOCKET, Path("/state"), WEB)
    assert child.users == file_of(chosen).path == Path("/state/access.json") and child.announce == "plain"
    assert understood(command(chosen, SOCKET, "json")[3:])[1].announce == "json"
    elsewhere = replace(chosen, users=Path("/u.json"))
    assert understood(command(elsewhere, SOCKET)[3:])[1].users == file_of(elsewhere).path == Path("/u.json")


def test_without_a_setting_it_is_that_of_a_plant_without_one() -> None:
    path, child = understood([str(SOCKET)])
    assert (path, child.directory, child.users) == (SOCKET, Path("/state"), Path("/state/access.json"))
    assert (child.web, child.announce) == (WebSetting(), "plain")


@pytest.mark.parametrize("words", [[], ["a", "b", "c"], [str(SOCKET), "{}"], [str(SOCKET), "x"]])
def test_what_is_no_such_command_line_is_refused(words: list[str]) -> None:
    with pytest.raises(ValueError):
        understood(words)
