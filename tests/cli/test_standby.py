"""A computer or program that was suspended: neither an old command line nor an old key starts a motor."""

from __future__ import annotations

import asyncio
import os
import sys
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.bus import timer
from drivebus.cli.commands import jog as jog_command
from drivebus.cli.commands import run as run_command
from drivebus.cli.commands.jog import FIRST_REPEAT_TIMEOUT_S, _is_held
from drivebus.cli.keyboard import KeyQueue, raw_keyboard
from drivebus.cli.main import cli
from drivebus.cli.signals import ShutdownSignal
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.testing.virtual_time import run


@pytest.mark.parametrize(("slept_s", "starts"), [(0.0, 1), (30.0, 1), (61.0, 0), (8 * 3600.0, 0)])
def test_a_run_that_slept_before_its_start_starts_nothing_when_the_computer_wakes(
    monkeypatch: pytest.MonkeyPatch, slept_s: float, starts: int
) -> None:
    """It slept while it read the reaction to a communication loss; the motor started hours later."""
    offset_s = 0.0

    async def sleep_over(drive: Any) -> None:
        nonlocal offset_s
        offset_s = slept_s

    monkeypatch.setattr(run_command, "print_comm_loss", sleep_over)
    monkeypatch.setattr(timer, "loop_now", lambda loop: loop.time() + offset_s)
    clear_simulated_buses()
    words = ("sim://c320@1?ramp=1&name=standby", "--model", "c320", "--address", "1", "--frequency", "5", "--detach")
    found = CliRunner().invoke(cli, ["run", *words, "--lang", "en"], env={"COLUMNS": "300"})
    bus = find_simulated_bus("standby")
    assert bus is not None and bus.stations[0].motor.starts == starts
    clear_simulated_buses()
    assert found.exit_code == (0 if starts else 1), found.output
    assert ("it was not sent" in found.output) is not bool(starts)


class Clock:
    """Clock of a bus that a standby moves on."""

    slept_s = 0.0

    def now(self) -> float:
        return asyncio.get_running_loop().time() + self.slept_s


async def is_held(batches: list[tuple[float, str]], slept_s: float = 0.0) -> bool:
    """Return whether the first key counts as held, with further keys read together after these pauses."""
    keys, clock = KeyQueue(), Clock()
    loop = asyncio.get_running_loop()
    for pause_s, text in batches:
        loop.call_later(pause_s, keys.on_keys, text)
    key = await keys.get()
    assert key is not None
    if slept_s:
        loop.call_later(0.1, setattr, clock, "slept_s", slept_s)
    bus: Any = clock
    return await _is_held(bus, keys, key)


@pytest.mark.parametrize(
    ("batches", "slept_s", "held"),
    [
        ([(0.0, " "), (0.5, " ")], 0.0, True),
        ([(0.0, "  "), (0.03, " ")], 0.0, True),
        ([(0.0, " ")], 0.0, False),
        ([(0.0, " " * 300)], 0.0, False),
        ([(0.0, " "), (0.5, "r")], 0.0, False),
        ([(0.0, " "), (0.5, " ")], FIRST_REPEAT_TIMEOUT_S, False),
    ],
    ids=["held", "held, read late", "pressed once", "waited while frozen", "another key", "repeated before a standby"],
)
def test_only_a_key_that_is_still_repeated_is_held(
    batches: list[tuple[float, str]], slept_s: float, held: bool
) -> None:
    """The keys that waited for a frozen program started a jog, however long ago they were released."""
    assert run(is_held(batches, slept_s)) is held


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminal")
def test_all_keys_that_waited_in_the_terminal_are_read_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read in two parts, the second one passed for repeats of a key that is still held."""
    far, near = os.openpty()

    async def keys_of_a_frozen_program() -> bool:
        with os.fdopen(near, closefd=False) as terminal:
            monkeypatch.setattr("sys.stdin", terminal)
            with raw_keyboard() as keys:
                os.write(far, b"f" * 1000)
                key = await keys.get()
                assert key == "f"
                bus: Any = Clock()
                return await _is_held(bus, keys, key)

    assert not asyncio.run(keys_of_a_frozen_program())
    os.close(far)
    os.close(near)


def test_a_single_press_after_a_jog_starts_no_other_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A repeat that was left in the queue made the next single press a held key."""
    jogs: list[str] = []

    async def jog_and_leave_a_repeat(session: Any, bus: Any, keys: KeyQueue, shutdown: Any, key: str, *_: Any) -> None:
        jogs.append(key)
        keys.on_keys("ff")
        asyncio.get_running_loop().call_later(0.5, keys.on_keys, "f")
        asyncio.get_running_loop().call_later(5.0, keys.on_keys, "q")

    class JoggedDrive:
        def jog(self, *_: Any, **__: Any) -> None:
            """Begin no session: the jog itself is replaced."""

    async def scenario() -> None:
        keys, bus = KeyQueue(), Clock()
        for pause_s in (0.1, 0.4):
            asyncio.get_running_loop().call_later(pause_s, keys.on_keys, "f")
        drive: Any = JoggedDrive()
        await jog_command._until_quit(bus, drive, keys, ShutdownSignal(), 5.0)  # type: ignore[arg-type]

    monkeypatch.setattr(jog_command, "_jog_while_held", jog_and_leave_a_repeat)
    run(scenario())
    assert jogs == ["f"]
