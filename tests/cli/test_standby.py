"""A computer or program that was suspended: neither an old command line nor an old key starts a motor."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.bus import timer
from drivebus.cli.commands import run as run_command
from drivebus.cli.commands.jog import FIRST_REPEAT_TIMEOUT_S, _is_held
from drivebus.cli.keyboard import KeyQueue
from drivebus.cli.main import cli
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
