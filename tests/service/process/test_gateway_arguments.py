"""The line of arguments that the service writes to a gateway's process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.service.auth.admin import user_file_of
from drivebus.service.config.model import GatewayConfig
from drivebus.service.process.gateway_arguments import decode_arguments, encode_arguments, gateway_arguments
from drivebus.web.gateway import WebConfig
from fixtures.service import plant_config

WEB = WebConfig(
    host="::",
    port=8443,
    certificate=Path("/c.pem"),
    key=Path("/k.pem"),
    origins=("https://plant.example",),
)
GATEWAY = GatewayConfig(id="web", module="drivebus.web", settings=WEB)
PLANT = plant_config(directory=Path("/state"), gateways=(GATEWAY,))


def test_the_process_decodes_what_the_service_encodes() -> None:
    line = encode_arguments(gateway_arguments(PLANT, GATEWAY, had_users=True))
    assert line.count(b"\n") == 1 and line.endswith(b"\n")
    found = decode_arguments(line, WebConfig)
    assert (found.socket, found.directory) == (Path("/state/plant.sock"), Path("/state"))
    assert (found.settings, found.address_output, found.had_users) == (WEB, "plain", True)


def test_the_address_output_and_the_user_file_are_the_plants() -> None:
    found = gateway_arguments(PLANT, GATEWAY, "json")
    assert (found.address_output, found.user_file) == ("json", Path("/state/users.json"))
    assert found.user_file == user_file_of(PLANT).path
    elsewhere = replace(PLANT, users=Path("/u.json"))
    assert gateway_arguments(elsewhere, GATEWAY).user_file == user_file_of(elsewhere).path == Path("/u.json")


@pytest.mark.parametrize("line", [b"", b"\n", b"{}\n", b"x\n", b'{"socket": "/s"}\n'])
def test_any_other_line_is_rejected(line: bytes) -> None:
    with pytest.raises(ValueError):
        decode_arguments(line, WebConfig)
