"""The demo: its plant, its script, and the terminal view as a client of the service."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import unicodedata
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.cli.demo import host
from drivebus.cli.demo.layout import BUSES
from drivebus.cli.demo.plant import MemoryDemoPlant, PtyDemoPlant
from drivebus.cli.demo.plant_toml import FAULT_PROFILE, fault_profile_toml, plant_toml
from drivebus.cli.demo.script import END_S, OPENING, PAGE_CONTINUATION, TERMINAL_CONTINUATION, ScriptPlayer, caption
from drivebus.cli.demo.terminal import DemoClient
from drivebus.cli.errors import ExitCode
from drivebus.service.config import load
from drivebus.simulator.models.c320 import FAULT_CODES
from drivebus.simulator.motor import Trip
from drivebus.testing import virtual_time
from drivebus.types import Json
from drivebus.values import Text

pytest.importorskip("pty")


def test_the_plant_has_at_least_eight_drives_of_all_four_families_on_four_buses() -> None:
    assert sum(len(bus.drives) for bus in BUSES) >= 8
    assert {profiles.load(bus.model).family for bus in BUSES} == {"sunfar", "dzb100", "modbus"}
    assert {bus.model for bus in BUSES} == {"c320", "dzb100", "vc660", "df800"}
    assert len({bus.name for bus in BUSES}) == 4


def test_the_script_has_starts_a_trip_a_reset_and_an_adapter_that_is_unplugged_and_plugged() -> None:
    steps = OPENING + TERMINAL_CONTINUATION
    actions = [step.action for step in steps]
    assert {"run", "set", "trip", "reset", "unplug", "plug", "stop", "stop_all"} <= set(actions)
    assert [step.at_s for step in steps] == sorted(step.at_s for step in steps)
    assert 35.0 <= END_S <= 45.0


def test_the_page_tells_each_step_in_both_languages_and_shows_the_trip_and_the_adapter() -> None:
    steps = OPENING + PAGE_CONTINUATION
    assert [step.at_s for step in steps] == sorted(step.at_s for step in steps)
    assert {"trip", "unplug", "plug"} <= {step.action for step in steps}
    captions = [caption(step) for step in steps]
    assert all(text["en"].startswith("Demo: ") and text["zh"].startswith("演示：") for text in captions)
    assert all("{" not in text[language] for text in captions for language in ("en", "zh"))
    tripped = next(text for step, text in zip(steps, captions, strict=True) if step.action == "trip")
    assert "fan 3" in tripped["en"] and "风机 3 的电机" in tripped["zh"]
    assert not [text["zh"] for text in captions if re.search("[0-9A-Za-z][一-鿿]|[一-鿿][0-9A-Za-z]", text["zh"])]


@pytest.mark.parametrize(("language", "names_current"), [("en", "current"), ("zh", "电流")])
def test_the_cause_of_the_trip_fits_into_its_line_of_the_red_box(language: str, names_current: str) -> None:
    """On a page of 1280 px 55 letters of it were shown, and the rest was cut off; a Chinese character is two wide."""
    cause = i18n.text("demo.fault.cause", language)
    assert sum(2 if unicodedata.east_asian_width(character) in "WF" else 1 for character in cause) < 55
    assert names_current in cause, "the same in both languages"


@pytest.mark.parametrize("interrupted", [False, True])
def test_the_end_of_the_demo_says_that_no_drive_is_left_running(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], interrupted: bool
) -> None:
    """Fans that still ramped down ended without a word, while `serve` names every stop that is not confirmed."""

    async def run_with_page(*_: object) -> None:
        if interrupted:
            os.kill(os.getpid(), signal.SIGINT)
            await asyncio.sleep(60.0)

    monkeypatch.setattr(host, "_run_with_page", run_with_page)
    code = asyncio.run(host._run_until_signal(8080))
    assert code is (ExitCode.INTERRUPTED if interrupted else ExitCode.DONE)
    assert "its simulated drives with it" in capsys.readouterr().out


def test_the_last_sentence_of_the_demo_does_not_stand_behind_the_ctrl_c_of_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its lines are wrapped for the whole width, and the last word was broken."""

    async def run_with_page(*_: object) -> None:
        return

    monkeypatch.setattr(host, "_run_with_page", run_with_page)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    asyncio.run(host._run_until_signal(8080))
    assert capsys.readouterr().out.startswith("\n")


@pytest.mark.parametrize("run", [lambda: host._run_with_page(Path(), 8080), lambda: host.serve_terminal(memory=False)])
async def test_a_demo_that_is_interrupted_while_its_drives_start_waits_for_their_end(
    monkeypatch: pytest.MonkeyPatch, run: Callable[[], Coroutine[Any, Any, None]]
) -> None:
    """The folder of the drives was removed while they started, and a traceback followed the last sentence."""
    plant = PtyDemoPlant()
    monkeypatch.setattr(host, "create_demo_plant", lambda: plant)
    demo = asyncio.create_task(run())
    await until(lambda: plant._child is not None)
    child = plant._child
    assert child is not None
    demo.cancel()
    await asyncio.gather(demo, return_exceptions=True)
    assert child.returncode is not None


def test_the_trip_of_the_demo_has_a_cause_and_a_remedy(tmp_path: Path) -> None:
    (tmp_path / FAULT_PROFILE).write_text(fault_profile_toml(), encoding="utf-8")
    file = tmp_path / "plant.toml"
    notice = {"en": "user demo", "zh": "用户 demo"}
    file.write_text(plant_toml([f"sim://{bus.target}" for bus in BUSES], tmp_path, 0, notice), encoding="utf-8")
    config = load(file)
    assert config.gateway("web").settings.login_notice == Text("user demo", "用户 demo")
    tripped = next(step.subject for step in OPENING if step.action == "trip")
    model = next(drive.model for drive in config.drives if drive.id == tripped)
    fault = profiles.load(model).fault(FAULT_CODES[Trip.OVERCURRENT_RUNNING])
    assert fault.cause is not None and fault.remedy is not None and fault.evidence is not None
    assert fault.evidence.kind == "user", "it does not pass for the maker's text"


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition, at most until the timeout of the test."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.1)


async def test_the_whole_script_plays_and_ends_with_every_drive_stopped() -> None:
    client = DemoClient()
    await client.start()
    try:
        await until(lambda: client.finished)
        await until(lambda: all(row.state in ("stopped", "unknown") for row in client.drives()))  # once a second
        states = {row.name: row.state for row in client.drives()}
        buses_up = [row.up for row in client.buses()]
    finally:
        await client.close()
    assert {state for name, state in states.items() if not name.startswith("pump")} == {"stopped"}
    assert {state for name, state in states.items() if name.startswith("pump")} == {"unknown"}
    assert buses_up == [True] * 4
    messages = "\n".join(client.messages())
    for part in ("its motor jams", "the fault is gone", "pulled out", "the adapter is back", "End of the script"):
        assert part in messages
    assert "NOT CONFIRMED" not in messages


async def test_the_first_key_ends_the_script_and_reset_releases_the_start_inhibit_of_a_stop_of_all() -> None:
    client = DemoClient()
    await client.start()
    messages = client.messages()
    try:
        await until(lambda: any(row.key == "spindle-3" and row.state == "stopped" for row in client.drives()))
        client.run("spindle-3")
        await until(lambda: any(line.startswith("spindle 3: the drive reports") for line in messages))
        client.stop_all()
        await until(lambda: any(line.startswith("All drives:") for line in messages))
        client.run("spindle-3")
        await until(lambda: any("x (reset) releases it" in line for line in messages))
        client.reset("spindle-3")
        await until(lambda: any("is released" in line for line in messages))
        before = len(messages)
        await asyncio.sleep(1.0)
        client.run("spindle-3")
        await until(lambda: any("accelerating" in line or "running" in line for line in messages[before:]))
    finally:
        await client.close()
    text = "\n".join(messages)
    assert "You have control" in text and "pulled out" not in text
    assert not client._tasks and client._process is None


def test_a_script_that_is_taken_over_sends_no_further_command() -> None:
    calls: list[tuple[str, Json]] = []

    async def call(operation: str, params: Json) -> Json:
        calls.append((operation, params))
        return {"outcome": {"status": "confirmed", "text": {"en": "ok", "zh": "ok"}, "notes": [], "frames": []}}

    async def play() -> None:
        messages: list[str] = []
        player = ScriptPlayer(call, MemoryDemoPlant(), messages.append)
        playing = asyncio.create_task(player.play(OPENING + TERMINAL_CONTINUATION, END_S))
        await asyncio.sleep(4.5)
        player.take_over()
        await playing
        assert "You have control" in messages[-1] or "You have control" in messages[-2]

    virtual_time.run(play())
    assert [params["drive"] for name, params in calls if name == "drive.run"] == ["fan-1", "spindle-1", "conveyor-1"]
