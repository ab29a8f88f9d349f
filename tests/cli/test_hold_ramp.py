"""``hold-ramp`` names its end before it holds, and Ctrl-C ends it by a stop."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from drivebus import i18n
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
