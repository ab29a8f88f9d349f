"""A stop, and a service, go on where their output can't be written: full disk, closed pipe, closed terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli import output
from drivebus.cli.commands import stop
from drivebus.cli.main import cli
from drivebus.cli.output import ProgressBar
from drivebus.cli.stop_errors import stop_to_the_end
from fixtures.child_process import CHILD_TIMEOUT_S, COMMAND, ENVIRONMENT

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="shell, signals and devices of POSIX")

STOP = ("stop", "sim://c320@1", "--model", "c320", "--address", "1")
FAST = ("--baud", "57600")  # not in the manual: a note is printed before the stop is sent
LOST = "standard output can't be written"


def run_shell(redirection: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a redirection of its streams."""
    line = f'exec "$@" {redirection}'
    return subprocess.run(
        ["sh", "-c", line, "sh", *words],
        input="",
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        timeout=CHILD_TIMEOUT_S,
    )


@pytest.mark.parametrize(
    ("words", "redirection", "shown"),
    [
        (STOP, ">/dev/full", f"{LOST}: No space left on device"),
        ((*STOP, "--json"), ">/dev/full", f"{LOST}: No space left on device"),
        ((*STOP, *FAST), "2>/dev/full", "Confirmed: the drive reports stopped"),
        (STOP, ">&-", ""),
        (("stop", "--all", *STOP[1:]), "2>&-", "Stopped, confirmed: 1."),
        (("stop", "--all", *STOP[1:], *FAST), ">/dev/full 2>&1", ""),
        (STOP, "<&- >&- 2>&-", ""),
    ],
)
def test_a_stop_is_sent_confirmed_and_ends_with_its_own_code_where_its_output_is_lost(
    words: tuple[str, ...], redirection: str, shown: str
) -> None:
    """A closed standard error ended ``stop --all``, a full one any stop with a note, before a frame was sent."""
    result = run_shell(redirection, *COMMAND, *words)
    assert (result.returncode, result.stdout + result.stderr) == (0, result.stdout + result.stderr)
    assert shown in result.stdout + result.stderr
    assert "Traceback" not in result.stderr


def test_the_reader_of_a_pipe_that_is_gone_changes_no_exit_code_of_a_stop() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        result = subprocess.run(
            [*COMMAND, *STOP],
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            env=ENVIRONMENT,
            timeout=CHILD_TIMEOUT_S,
        )
    finally:
        os.close(writer)
    assert (result.returncode, f"{LOST}: Broken pipe" in result.stderr) == (0, True)


@pytest.mark.parametrize("redirection", [">/dev/full", "2>/dev/full", ">/dev/full 2>&1"])
def test_an_unconfirmed_stop_ends_with_four_where_its_output_is_lost(redirection: str) -> None:
    words = ("stop", "--all", "--directory", "/nowhere/state", "--json")
    assert run_shell(redirection, *COMMAND, *words).returncode == 4


def test_a_wrong_usage_ends_with_two_where_its_output_is_lost() -> None:
    assert run_shell(">/dev/full", *COMMAND, "stop", "--unknown", "--json").returncode == 2


STREAMS = """
import json, os, sys
from drivebus.terminal import open_missing_streams
open_missing_streams()
opened = os.open("/dev/zero", os.O_RDONLY)
print("text"); print("text", file=sys.stderr); sys.stdin.read(0)
is_null = [os.readlink(f"/proc/self/fd/{number}") == "/dev/null" for number in range(3)]
with open(sys.argv[1], "w") as file:
    json.dump([is_null, opened, [os.get_inheritable(number) for number in range(3)]], file)
"""


@pytest.mark.parametrize(
    ("redirection", "is_null"),
    [("", [False, False, False]), ("2>&-", [False, False, True]), ("<&- >&- 2>&-", [True, True, True])],
)
def test_a_stream_that_is_closed_gets_no_port_in_its_place(
    tmp_path: Path, redirection: str, is_null: list[bool]
) -> None:
    """The first file that is opened gets a free number: what is written to standard error would go to the bus."""
    found = tmp_path / "found.json"
    run_shell(redirection, sys.executable, "-c", STREAMS, str(found))
    assert json.loads(found.read_text()) == [is_null, 3, [True, True, True]]


LOG = """
import sys
from drivebus.cli import output
from drivebus.terminal import print_line
with output.continue_without_output():
    output.print_text("ready")
print_line("http://127.0.0.1", sys.stdout)
print_line("the log", sys.stderr)
"""


def test_a_full_disk_under_standard_output_takes_no_line_of_the_log() -> None:
    """Both streams were discarded, so that a service ran without its log and printed no set-up secret."""
    result = run_shell(">/dev/full", sys.executable, "-c", LOG)
    assert (result.returncode, result.stderr.splitlines()[-1]) == (0, "the log")


def test_a_line_that_can_t_be_written_ends_no_process() -> None:
    """The web process ended at its first line, and so did each one that replaced it."""
    program = "import sys; from drivebus.terminal import print_line; print_line('address', sys.stdout); print('on')"
    result = run_shell(">/dev/full", sys.executable, "-c", program)
    assert (result.returncode, result.stderr) == (0, "")


def test_outside_of_a_stop_a_lost_output_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise ``monitor`` would go on without a reader."""

    def fail(*given: Any, **named: Any) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(output.click, "echo", fail)
    with output.continue_without_output():
        output.print_text("shown")
    with pytest.raises(BrokenPipeError):
        output.print_text("shown")


def test_a_closed_terminal_does_not_end_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection that was cut in the middle of ``stop --all`` left the other drives running."""

    async def request_stop(folder: Any) -> Any:
        os.kill(os.getpid(), signal.SIGHUP)
        return {"buses": {}, "outcomes": {"fan": {"status": "confirmed"}}}

    monkeypatch.setattr(stop, "_request_stop", request_stop)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        result = CliRunner().invoke(cli, ["stop", "--all", "--directory", "state", "--lang", "en"])
        assert (result.exit_code, signal.getsignal(signal.SIGHUP)) == (0, signal.SIG_DFL)
        assert "Stopped, confirmed: fan." in result.stdout
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with stop_to_the_end(dry_run=False):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN, "nohup"
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with stop_to_the_end(dry_run=True):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_progress_bar_on_a_closed_terminal_ends_no_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """It raised an error between the stops of a bus and their confirmation."""

    class Bar:
        def stop(self) -> None:
            raise OSError(5, "Input/output error")

    bar = ProgressBar()
    with bar:
        bar._bar = Bar()
