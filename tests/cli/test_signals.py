"""Every end of an attached run stops the drive: Ctrl-C, Ctrl-\\, a closed terminal, a request to terminate."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from fixtures.child_process import (
    CHILD_TIMEOUT_S,
    COMMAND,
    ENVIRONMENT,
    SLOW_MACHINE_C320,
    PtyTerminal,
    lines_until,
    running_command,
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and ptys of POSIX")


SIMULATED_DRIVE = ("--model", "c320", "--address", "1")
DRIVE = ("--model", str(SLOW_MACHINE_C320), "--address", "1")


def finished(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command on the drive until it ends."""
    return subprocess.run(
        [*COMMAND, *words, *DRIVE, "--json"], capture_output=True, text=True, env=ENVIRONMENT, timeout=CHILD_TIMEOUT_S
    )


class Plant:
    """``simulate`` in a process of its own, which shows after the end of the command whether the motor stopped."""

    def __init__(self, url: str) -> None:
        self.url = url

    def run(self, command: str, *more: str, codes: tuple[int, ...] = (0,)) -> dict[str, Any]:
        """Run a command on the same drive once the port is free; return its JSON document."""
        result = finished(command, self.url, *more)
        assert result.returncode in codes, result.stderr
        document: dict[str, Any] = json.loads(result.stdout)
        return document

    def state(self) -> str:
        """Return the state that ``status`` reads."""
        return str(self.run("status")["state"])


@contextmanager
def simulated(*where: str) -> Iterator[Plant]:
    with running_command("simulate", "--json", *SIMULATED_DRIVE, "--ramp", "1", "--baud", "19200", *where) as process:
        assert process.stdout is not None
        yield Plant(json.loads(process.stdout.readline())["url"])


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with simulated("--link", str(tmp_path_factory.mktemp("plant") / "drive")) as found:
        yield found


@pytest.fixture
def tcp_plant() -> Iterator[Plant]:
    """Provide a plant behind TCP, where a second master can connect."""
    with simulated("--bind", "tcp://127.0.0.1:0") as found:
        yield found


@pytest.fixture
def offline_drive() -> Iterator[str]:
    """Provide a port that accepts every byte and never replies, as a drive without power."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


def run_words(plant: Plant, *more: str) -> tuple[str, ...]:
    return ("run", plant.url, *DRIVE, "--frequency", "20", *more)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP])
def test_a_signal_stops_the_drive_confirms_it_and_exits_with_130(plant: Plant, number: signal.Signals) -> None:
    with running_command(*run_words(plant, "--json")) as process:
        lines_until(process, lambda line: '"event": "status"' in line)
        process.send_signal(number)
        code = process.wait(CHILD_TIMEOUT_S)
        documents = [json.loads(line) for line in (process.stdout or ())]
    assert code == 130
    assert (documents[-1]["event"], documents[-1]["outcome"]) == ("stopped", "confirmed")
    assert plant.state() == "stopped"


def test_a_closed_terminal_stops_the_drive(plant: Plant) -> None:
    with PtyTerminal(*run_words(plant)) as terminal:
        terminal.wait_for("out 20")
        terminal.hang_up()
        assert terminal.exit_code() == 130
    assert plant.state() == "stopped"


def test_a_closed_pipe_stops_the_drive(plant: Plant) -> None:
    """The first text that cannot be written (``drivebus run … | head -1``) ends the run with a stop."""
    with running_command(*run_words(plant)) as process:
        lines_until(process, lambda line: line.startswith("running"))
        assert process.stdout is not None
        process.stdout.close()
        assert process.wait(CHILD_TIMEOUT_S) == 130
        process.stdout = None
    assert plant.state() == "stopped"


def test_ctrl_c_stops_the_drive_and_a_second_one_does_not_interrupt_the_stop(plant: Plant) -> None:
    with PtyTerminal(*run_words(plant)) as terminal:
        terminal.wait_for("running")
        terminal.press("\x03")
        terminal.wait_for("Stopping")
        terminal.press("\x03")
        assert terminal.exit_code() == 130
        assert "Confirmed:" in terminal.output.partition("Stopping")[2]
    assert plant.state() == "stopped"


def test_a_detached_run_reports_the_communication_loss_behaviour_and_leaves_the_drive_running(plant: Plant) -> None:
    with running_command(*run_words(plant, "--detach", "--json")) as process:
        output, _ = process.communicate(timeout=CHILD_TIMEOUT_S)
    events = [json.loads(line) for line in output.splitlines()]
    assert process.returncode == 0
    assert [event["event"] for event in events] == ["comm_loss", "started"]
    assert plant.state() in ("accelerating", "running")
    assert plant.run("stop")["outcome"] == "confirmed"
    assert plant.state() == "stopped"


def test_run_exits_with_1_when_another_master_stops_the_drive(tcp_plant: Plant) -> None:
    """The stop of another master arrives while the command is suspended; then it reads a stopped drive."""
    with running_command(*run_words(tcp_plant)) as process:
        lines_until(process, lambda line: line.startswith("running"))
        os.kill(process.pid, signal.SIGSTOP)
        with socket.create_connection(("127.0.0.1", int(re.findall(r":(\d+)", tcp_plant.url)[0]))) as other:
            other.settimeout(CHILD_TIMEOUT_S)
            other.sendall(bytes.fromhex("2A 30 31 34 30 33 30 30 30 30 30 31 42 38 0D"))
            assert other.recv(64), "the reply to the stop"
        os.kill(process.pid, signal.SIGCONT)
        process.communicate(timeout=CHILD_TIMEOUT_S)
    assert process.returncode == 1


def test_jog_turns_only_while_a_key_is_held_and_stops_when_it_is_released(plant: Plant) -> None:
    """A single key press starts nothing; the key repeat starts the motor; its end stops it within the lease."""
    with PtyTerminal("jog", plant.url, *DRIVE) as terminal:
        terminal.wait_for("Hold the space bar")
        terminal.press(" ")
        time.sleep(1.2)
        terminal.read()
        assert "Acknowledged" not in terminal.output
        terminal.wait_for("Acknowledged", meanwhile=lambda: terminal.press(" "))
        terminal.wait_for("Confirmed")
        terminal.press("q")
        assert terminal.exit_code() == 0
    assert plant.state() == "stopped"


@pytest.mark.parametrize(("key", "end"), [("F", "Q"), ("ｒ", "ｑ")])
def test_jog_takes_its_keys_with_caps_lock_and_in_full_width(plant: Plant, key: str, end: str) -> None:
    with PtyTerminal("jog", plant.url, *DRIVE) as terminal:
        terminal.wait_for("Hold the space bar")
        terminal.wait_for("Acknowledged", meanwhile=lambda: terminal.press(key))
        terminal.wait_for("Confirmed")
        terminal.press(end)
        assert terminal.exit_code() == 0
    assert plant.state() == "stopped"


def test_jog_names_what_the_drive_does_on_a_communication_loss_before_the_first_key(plant: Plant) -> None:
    """The dead-man timer is in the program: behind a lost adapter nothing but the drive itself ends the jog."""
    with PtyTerminal("jog", plant.url, *DRIVE) as terminal:
        terminal.wait_for("ends the jog")
        printed = " ".join(terminal.output.split())
        reaction, _, how = printed.partition("Hold the space bar")
        assert "communication loss" in reaction
        assert "only the drive's own communication-loss time ends the jog" in how
        terminal.press("q")
        assert terminal.exit_code() == 0


@pytest.mark.parametrize(
    ("model", "words", "key"),
    [
        ("dzb100", (), "drives.jog_needs_frequency"),
        ("vc660", ("--frequency", "5"), "drives.jog_frequency_keypad"),
        ("dc1", (), "drives.cannot"),
        ("c320", ("--frequency", "900"), "drives.above_maximum"),
    ],
)
def test_jog_refuses_a_frequency_before_a_key_is_held(model: str, words: tuple[str, ...], key: str) -> None:
    with PtyTerminal("jog", f"sim://{model}@1", "--model", model, "--address", "1", *words, "--json") as terminal:
        terminal.wait_for(key)
        assert terminal.exit_code() != 0
    assert '"comm_loss"' not in terminal.output, "no question to the drive comes before it"


def test_jog_of_a_drive_whose_direction_is_calibrated_is_not_refused() -> None:
    """The check before the first key did not know it, and refused every jog of a DF800."""
    more = ("--option", "direction_calibrated=true")
    with PtyTerminal("jog", "sim://df800@1", "--model", "df800", "--address", "1", *more) as terminal:
        terminal.wait_for("Hold the space bar")
        terminal.press("q")
        assert terminal.exit_code() == 0


def test_jog_stops_when_the_terminal_is_closed(plant: Plant) -> None:
    with PtyTerminal("jog", plant.url, *DRIVE) as terminal:
        terminal.wait_for("Hold the space bar")
        terminal.wait_for("Acknowledged", meanwhile=lambda: terminal.press("f"))
        terminal.hang_up()
        terminal.exit_code()
    assert plant.state() == "stopped"


def test_a_jog_whose_adapter_is_pulled_ends_while_the_key_is_still_held(tmp_path: Path) -> None:
    """The motor turns on and no stop can be sent: nothing said so before the key was released."""
    link = tmp_path / "drive"
    words = ("simulate", "--json", *SIMULATED_DRIVE, "--baud", "19200", "--link", str(link))
    with running_command(*words) as adapter:
        assert adapter.stdout is not None
        with PtyTerminal("jog", json.loads(adapter.stdout.readline())["url"], *DRIVE) as terminal:
            terminal.wait_for("Acknowledged", meanwhile=lambda: terminal.press(" "))
            link.unlink()  # as udev does; the number of its pty is free for another test
            adapter.kill()
            terminal.wait_for("STOP NOT SENT", meanwhile=lambda: terminal.press(" "))
            assert terminal.exit_code() == 4


def test_an_unconfirmed_stop_exits_with_4(offline_drive: str) -> None:
    result = finished("stop", offline_drive)
    assert result.returncode == 4
    document = json.loads(result.stdout)
    assert document["error"]["type"] == "StopUnconfirmed"
    assert document["exit"] == 4


def test_a_drive_that_does_not_answer_is_not_started_and_exits_with_1(offline_drive: str) -> None:
    result = finished("run", offline_drive, "--frequency", "0.5")
    assert result.returncode == 1
    assert json.loads(result.stdout)["error"]["type"] in ("NoReply", "PreflightError")
