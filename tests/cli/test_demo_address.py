"""The address that the demo prints."""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path
from typing import Any

import pytest

from drivebus.cli import output
from drivebus.cli.demo import host
from drivebus.cli.demo.script import ScriptStep
from drivebus.service.config.model import GatewayConfig
from drivebus.web.gateway import WebConfig
from fixtures.service import plant_config


async def _do_nothing(*_: Any, **__: Any) -> None:
    pass


def test_the_address_is_printed_even_if_the_page_answers_late(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = host.free_port(0)
    web = GatewayConfig(id="web", module="drivebus.web", settings=WebConfig(port=port))
    config = plant_config(directory=tmp_path, gateways=(web,))
    monkeypatch.setattr(host, "PAGE_TIMEOUT_S", 0.01)
    monkeypatch.setattr(host, "_play", _do_nothing)
    monkeypatch.setattr(host, "LAST_CAPTION_S", 0.0)
    shown: list[ScriptStep | None] = []

    async def late() -> None:
        noted = asyncio.Event()
        monkeypatch.setattr(output, "print_note", lambda *_, **__: noted.set())
        plant: Any = None
        announcing = asyncio.create_task(host._announce_and_play(config, "C0DE", "pass-word", plant, shown.append))
        await noted.wait()
        async with await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", port):
            await announcing

    asyncio.run(late())
    assert shown == [None], "the last caption of the script goes away"
    printed = capsys.readouterr().out
    assert f"http://127.0.0.1:{port}/#login=C0DE" in printed and "password pass-word" in printed


def test_a_password_that_is_easily_guessed_by_chance_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """About one demo of 5,000 ended with the error that its own password is easily guessed."""
    drawn = iter(("AbC_yxWws42w", "k3Zp_wR9vQx1"))
    monkeypatch.setattr(secrets, "token_urlsafe", lambda size: next(drawn))
    assert host.draw_password() == "k3Zp_wR9vQx1"
