"""How the plant starts its web process, and what that process understands of it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.service.auth.admin import user_file_of
from drivebus.service.config.model import WebConfig
from drivebus.service.process.web_args import parse_web_arguments, web_command
from fixtures.service import plant_config

WEB = WebConfig("::", 8443, Path("/c.pem"), Path("/k.pem"), ("https://plant.example",))
SOCKET = Path("/state/plant.sock")


def test_the_web_process_understands_what_the_plant_tells_it() -> None:
    chosen = plant_config(directory=Path("/state"), web=WEB)
    words = web_command(chosen, SOCKET)
    assert words[:3] == [sys.executable, "-m", "drivebus.web"]
    path, child = parse_web_arguments(words[3:])
    assert (path, child.directory, child.web) == (SOCKET, Path("/state"), WEB)
    assert child.user_file == user_file_of(chosen).path == Path("/state/users.json") and child.address_output == "plain"
    assert parse_web_arguments(web_command(chosen, SOCKET, "json")[3:])[1].address_output == "json"
    elsewhere = replace(chosen, users=Path("/u.json"))
    assert (
        parse_web_arguments(web_command(elsewhere, SOCKET)[3:])[1].user_file
        == user_file_of(elsewhere).path
        == Path("/u.json")
    )


def test_without_a_setting_it_is_that_of_a_plant_without_one() -> None:
    path, child = parse_web_arguments([str(SOCKET)])
    assert (path, child.directory, child.user_file) == (SOCKET, Path("/state"), Path("/state/users.json"))
    assert (child.web, child.address_output) == (WebConfig(), "plain")


@pytest.mark.parametrize("words", [[], ["a", "b", "c"], [str(SOCKET), "{}"], [str(SOCKET), "x"]])
def test_what_is_no_such_command_line_is_refused(words: list[str]) -> None:
    with pytest.raises(ValueError):
        parse_web_arguments(words)
