"""``hold-ramp`` names its end before it holds, and Ctrl-C ends it by a stop."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus import i18n
from drivebus.cli import connect
from drivebus.cli.commands.hold_ramp import _hold
from drivebus.cli.errors import ExitCode
from drivebus.drives.outcome import Outcome, OutcomeStatus
from fixtures.child_process import PtyTerminal, running_command

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and ptys of POSIX")

DRIVE = ("--model", "vc660", "--address", "1")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_ramp_hold_names_ctrl_c_which_stops_the_drive(tmp_path: Path, language: str) -> None:
    link = str(tmp_path / "drive")
    with running_command("simulate", "--json", *DRIVE, "--ramp", "1", "--baud", "19200", "--link", link) as simulator:
        assert simulator.stdout is not None
        url = json.loads(simulator.stdout.readline())["url"]
        with running_command("run", url, *DRIVE, "--frequency", "20", "--detach", "--json") as start:
            assert start.wait(60) == 0
        with PtyTerminal("hold-ramp", url, *DRIVE, "10", "--lang", language) as terminal:
            terminal.wait_for("Ctrl-C")
            terminal.press("\x03")
            assert terminal.exit_code() == 130
        announced, _, stopped = terminal.output.partition(i18n.text("run.stopping", language))
        assert "10 s" in announced and i18n.text("outcome.confirmed", language, text="") in stopped


@pytest.mark.parametrize(
    ("status", "code"),
    [(OutcomeStatus.CONFIRMED, ExitCode.INTERRUPTED), (OutcomeStatus.UNKNOWN, ExitCode.UNKNOWN)],
)
def test_the_exit_code_after_ctrl_c_is_that_of_a_stop_that_is_not_confirmed(
    status: OutcomeStatus, code: ExitCode, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def hold_ramp(seconds: float) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(60)

    async def stop(wait: bool) -> Outcome:
        return Outcome(status=status, key="drives.stop_answered")

    drive = SimpleNamespace(profile=SimpleNamespace(capabilities=()), hold_ramp=hold_ramp, stop=stop)

    @asynccontextmanager
    async def open_drive(target: Any) -> AsyncIterator[Any]:
        yield SimpleNamespace(now=lambda: 0.0), drive

    monkeypatch.setattr(connect, "open_drive", open_drive)
    target: Any = None
    assert asyncio.run(_hold(target, 1.0)) is code
