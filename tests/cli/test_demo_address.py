"""A web part that is late on a busy machine: the demo's address comes all the same."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus.cli import output
from drivebus.cli.demo import host


async def _nothing(*_: Any) -> None:
    pass


def test_the_address_is_told_however_late_the_page_answers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output.parse_global_options(["--lang", "en"])
    port = host.free_port(0)
    setting: Any = SimpleNamespace(web=SimpleNamespace(port=port), directory=tmp_path)
    monkeypatch.setattr(host, "PAGE_TIMEOUT_S", 0.01)
    monkeypatch.setattr(host, "_play", _nothing)

    async def late() -> None:
        waited = asyncio.Event()
        monkeypatch.setattr(output, "print_note", lambda *_, **__: waited.set())
        plant: Any = None
        telling = asyncio.create_task(host._announce_and_play(setting, "C0DE", "pass-word", plant))
        await waited.wait()
        async with await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", port):
            await telling

    asyncio.run(late())
    printed = capsys.readouterr().out
    assert f"http://127.0.0.1:{port}/#login=C0DE" in printed and "password pass-word" in printed
