"""An attached command goes on where nothing reads its output: a pager, Ctrl-S, a connection that hangs."""

from __future__ import annotations

import asyncio
import io
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

import pytest

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.background_output import BackgroundStream, background_output
from drivebus.cli.commands import run
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.signals import ShutdownSignal
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.testing import virtual_time

READER_RETURNS_S = 60.0  # a command that waits for its reader is caught then


class FullPipe:
    """Pipe that takes no byte until it is read."""

    def __init__(self) -> None:
        reader, writer = os.pipe()
        self.stream: TextIO = io.TextIOWrapper(os.fdopen(writer, "wb"), encoding="utf-8", write_through=True)
        os.set_blocking(writer, False)
        with suppress(BlockingIOError):
            while True:
                os.write(writer, bytes(4096))
        os.set_blocking(writer, True)
        self.text = ""
        self.is_read = threading.Event()
        self._timer = threading.Timer(READER_RETURNS_S, self.is_read.set)
        self._thread = threading.Thread(target=self._read, args=(reader,), daemon=True)
        self._timer.start()
        self._thread.start()

    def end(self) -> str:
        """Return the text that was written, once the last writer is gone."""
        self._timer.cancel()
        self.stream.close()
        self._thread.join()
        return self.text

    def _read(self, reader: int) -> None:
        self.is_read.wait()
        found = b""
        while data := os.read(reader, 65536):
            found += data
        self.text = found.replace(b"\0", b"").decode()
        os.close(reader)


def test_ctrl_c_stops_a_motor_while_the_reader_of_the_output_does_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command waited in the write of a status, without end: its motor ran on at every Ctrl-C."""
    clear_simulated_buses()
    pipe = FullPipe()

    @contextmanager
    def ctrl_c_after_some_seconds(**_: Any) -> Iterator[ShutdownSignal]:
        shutdown = ShutdownSignal()
        asyncio.get_running_loop().call_later(5.0, shutdown.request, "SIGINT")
        yield shutdown

    target = Target(port="sim://c320@1?name=run&ramp=1", model="c320", address=1, option=(("setpoint_step", "0.01"),))
    monkeypatch.setattr("drivebus.cli.signals.shutdown_signals", ctrl_c_after_some_seconds)
    monkeypatch.setattr("sys.stdout", pipe.stream)
    with background_output():
        code = virtual_time.run(run._run(target, 5.0, reverse=False, wait=False, detach=False))
        motor = find_simulated_bus("run").stations[0].motor
        stopped_before_it_was_read = not pipe.is_read.is_set()
        pipe.is_read.set()
    shown = pipe.end()
    clear_simulated_buses()
    assert (code, motor.starts, motor.energised) == (ExitCode.INTERRUPTED, 1, False)
    assert stopped_before_it_was_read
    assert "Confirmed: the drive reports stopped" in shown, "all but the status lines, which would be old"
    assert "output_frequency" not in shown and len(shown.splitlines()) < 10


def test_what_is_printed_meanwhile_comes_in_its_order_and_a_lost_reader_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pipe = FullPipe()
    background = BackgroundStream(pipe.stream)
    background.write("0\n")
    with monkeypatch.context() as patched:
        patched.setattr("drivebus.cli.background_output.WRITE_TIMEOUT_S", 10 * READER_RETURNS_S)
        for number in (1, 2):
            background.write(f"{number}\n")
    assert background.is_blocked and not pipe.is_read.is_set(), "only the first text waits for the reader, briefly"
    pipe.is_read.set()
    background.close()
    assert pipe.end() == "0\n1\n2\n"
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream:
        lost = BackgroundStream(stream)
        with pytest.raises(BrokenPipeError):
            lost.write("text")
        assert lost.close() is None, "it was raised already"


def test_a_text_that_waited_when_its_reader_went_away_is_called_lost(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The outcome of the stop was lost without a message."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, bytes(4096))
    os.set_blocking(writer, True)
    with os.fdopen(writer, "w") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        with background_output():
            output.echo("Confirmed")
            os.close(reader)
    assert i18n.text("cli.output_lost", "en", reason="Broken pipe") in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe of Windows can't be recognized")
@pytest.mark.parametrize("one_pipe", [True, False])
def test_lines_on_one_pipe_keep_their_order_while_it_is_not_read(
    monkeypatch: pytest.MonkeyPatch, one_pipe: bool
) -> None:
    """Regression: with ``2>&1 | less`` a warning came after the outcome that was printed after it."""
    pipe, other = FullPipe(), FullPipe()
    errors = os.fdopen(os.dup((pipe if one_pipe else other).stream.fileno()), "w")
    monkeypatch.setattr("sys.stdout", pipe.stream)
    monkeypatch.setattr("sys.stderr", errors)
    with background_output():
        for number in range(20):
            output.echo(f"{number}", err=number % 2 == 0)
        pipe.is_read.set()
        other.is_read.set()
    errors.close()
    found = [pipe.end().split(), other.end().split()]
    numbers = [str(number) for number in range(20)]
    assert found == ([numbers, []] if one_pipe else [numbers[1::2], numbers[::2]])
