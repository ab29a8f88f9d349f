"""A command, and a service, go on where their output can't be written: full disk, closed pipe, closed terminal."""

from __future__ import annotations

import asyncio
import io
import json
import os
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli import output
from drivebus.cli.commands import jog, stop
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.cli.output import ProgressBar
from drivebus.cli.remote.selection import print_results
from drivebus.cli.stop_errors import stop_to_the_end
from drivebus.errors import NotFound, StopUnconfirmed
from drivebus.service.api.errors import error_to_json
from drivebus.service.auth.users import UserFile
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.testing import virtual_time
from fixtures.child_process import CHILD_TIMEOUT_S, COMMAND, ENVIRONMENT
from fixtures.service import SHOP_FILE
from fixtures.web_app import USERS

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


DRIVE = STOP[1:]
WRITE = ("write", DRIVE[0], "F1.10=0010", *DRIVE[1:])


@pytest.mark.parametrize(
    ("words", "redirection", "shown"),
    [
        (("set-frequency", DRIVE[0], "10", *DRIVE[1:]), ">/dev/full", f"{LOST}: No space left on device"),
        (WRITE, ">/dev/full", f"{LOST}: No space left on device"),
        ((*WRITE, "--json"), ">/dev/full", f"{LOST}: No space left on device"),
        ((*WRITE, *FAST), "2>/dev/full", "Confirmed"),
        (WRITE, ">&-", ""),
        (("reset", *DRIVE), ">/dev/full 2>&1", ""),
        (
            ("coast", "sim://vc660@1", "--model", "vc660", "--address", "1"),
            ">/dev/full",
            f"{LOST}: No space left on device",
        ),
    ],
)
def test_a_command_ends_with_the_code_of_its_outcome_where_its_output_is_lost(
    words: tuple[str, ...], redirection: str, shown: str
) -> None:
    """It ended with 2, as if its usage were wrong and nothing had been sent."""
    result = run_shell(redirection, *COMMAND, *words)
    assert (result.returncode, result.stdout + result.stderr) == (0, result.stdout + result.stderr)
    assert shown in result.stdout + result.stderr


def test_a_command_that_was_rejected_ends_with_one_where_its_output_is_lost() -> None:
    words = ("set-frequency", DRIVE[0], "400", *DRIVE[1:])
    assert run_shell(">/dev/full", *COMMAND, *words).returncode == ExitCode.FAILED


def test_a_user_who_was_disabled_is_no_failure_where_the_output_is_lost(tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(SHOP_FILE)
    file = UserFile(tmp_path / "state" / "users.json")
    file.change(lambda _: USERS)
    assert run_shell(">/dev/full", *COMMAND, "user", "disable", str(plant), "viewer").returncode == 0
    assert file.read().user("viewer").disabled


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let standard output fail; standard error is written."""
    echo = output.click.echo

    def fail(text: str, err: bool = False, **more: Any) -> None:
        if not err:
            raise OSError(28, "No space left on device")
        echo(text, err=True, **more)

    monkeypatch.setattr(output.click, "echo", fail)


@pytest.mark.usefixtures("full_disk")
def test_a_release_ends_with_the_code_of_its_results_where_its_output_is_lost() -> None:
    refused = error_to_json(NotFound("plant.no_drive", drive="fan-2"))
    done: dict[str, Any] = {"fan-1": {"status": "done"}}
    keys = {"json_key": "released", "done": "release.done", "nothing": "release.nothing"}
    assert print_results(done, **keys) is ExitCode.DONE
    assert print_results({}, **keys) is ExitCode.DONE
    assert print_results(done | {"fan-2": refused}, **keys) is ExitCode.FAILED


class HeldKey:
    """Keyboard on which the space bar is held."""

    last_key = " "
    last_key_at = float("inf")

    async def get(self, timeout_s: float | None = None) -> str:
        await asyncio.sleep(0.1)
        return self.last_key

    def clear(self) -> None:
        pass


def jog_with_lost_output(monkeypatch: pytest.MonkeyPatch) -> tuple[ExitCode, Any]:
    """Jog a drive; no output can be written from its start on. Return exit code and motor."""
    clear_simulated_buses()
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("drivebus.cli.keyboard.raw_keyboard", lambda: nullcontext(HeldKey()))
    print_outcome = jog._print_jog_outcome

    def print_or_fail(outcome: Any, bus: Any, event: str) -> None:
        monkeypatch.setattr(output.click, "echo", raise_full_disk)
        print_outcome(outcome, bus, event)

    def raise_full_disk(text: str, **_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jog, "_print_jog_outcome", print_or_fail)
    port = "sim://c320@1?name=jog&ramp=1"

    async def run() -> ExitCode:
        return await asyncio.wait_for(jog._jog(Target(port=port, model="c320", address=1), 5.0), 60.0)

    code = virtual_time.run(run())
    motor = find_simulated_bus("jog").stations[0].motor
    clear_simulated_buses()
    return code, motor


def test_a_jog_whose_output_is_lost_ends_as_an_interrupted_one_with_its_motor_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    code, motor = jog_with_lost_output(monkeypatch)
    assert (code, motor.starts, motor.energised) == (ExitCode.INTERRUPTED, 1, False)


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


@pytest.mark.parametrize(("words", "code"), [(("--version",), 2), (STOP, 0)])
def test_a_closed_standard_output_is_an_error_but_not_of_a_stop(words: tuple[str, ...], code: int) -> None:
    """A status whose output was lost ended without a message, with the exit code of success."""
    result = run_shell(">&-", *COMMAND, *words)
    assert (result.returncode, "can't be written: Bad file descriptor" in result.stderr) == (code, True)


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


def test_a_lost_output_is_an_error_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise ``monitor`` would go on without a reader."""

    def fail(*given: Any, **named: Any) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(output.click, "echo", fail)
    with output.continue_without_output():
        output.print_text("shown")
    with pytest.raises(BrokenPipeError):
        output.print_text("shown")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a full disk of Linux")
def test_a_read_whose_output_is_lost_names_the_output() -> None:
    """The message named a file "-", and asked for another path."""
    found = run_shell(">/dev/full", *COMMAND, "models", "--lang", "en")
    assert found.returncode == 2
    assert found.stderr.startswith("drivebus: the output, or a file of this command, can't be written: No space left")


def test_ctrl_z_does_not_suspend_a_stop() -> None:
    """The motor ran on until ``fg``, with the port held."""
    found = signal.getsignal(signal.SIGTSTP)
    with stop_to_the_end(dry_run=False):
        assert signal.getsignal(signal.SIGTSTP) is signal.SIG_IGN
    assert signal.getsignal(signal.SIGTSTP) is found is signal.SIG_DFL


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGQUIT])
def test_a_stop_that_a_signal_ends_is_reported_as_not_confirmed(number: signal.Signals) -> None:
    """It ended without a word, as under ``timeout``, while the motor may have run on."""
    before = signal.signal(number, signal.SIG_DFL)  # a shell ignores SIGQUIT in what it starts in the background
    try:
        with pytest.raises(StopUnconfirmed) as found, stop_to_the_end(dry_run=False):
            assert signal.getsignal(number) is signal.default_int_handler
            signal.raise_signal(number)
        assert (found.value.key, signal.getsignal(number)) == ("bus_stop.interrupted", signal.SIG_DFL)
    finally:
        signal.signal(number, before)


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


@pytest.mark.parametrize("closed_before", [False, True])
def test_a_progress_bar_goes_on_where_its_terminal_is_closed(
    monkeypatch: pytest.MonkeyPatch, closed_before: bool
) -> None:
    """A drive that was found after the terminal had been closed ended the search for the others."""

    class Terminal(io.StringIO):
        is_closed = closed_before

        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            if self.is_closed:
                raise OSError(5, "Input/output error")
            return super().write(text)

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with ProgressBar() as bar:
        terminal.is_closed = True
        bar.print_above("drive 1")
        bar.update("drive 2", 1.0, 2.0)
    assert bool(terminal.getvalue()) is not closed_before
