"""Row of the table: the adapter gives our own bytes back."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from drivebus.errors import DrivebusError
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.reference.request_effects import RequestEffect

COMPLETED_WORDS = ("confirmed", "acknowledged")
ABSENT_ADDRESS = 9


@cell("echo")
def adapter_echo(at: CellRun) -> None:
    """Removed where the adapter is known to echo; where the setting is wrong, nothing is believed. Never an answer."""
    for setting in ("on", "detect"):
        line = at.bus(1, echo=setting, line_quality="echo")
        answer = line.read(1)
        line.expect(answer.error is None and answer.received == line.replies[-1].data, f"echo {setting}: {answer}")
        command = line.command_to_end(1, "run", at.random_hz())
        line.expect(
            command.result_word == ("confirmed" if at.kind.reports_running else "acknowledged"),
            f"echo {setting}: run {command.result_word}",
        )
        line.expect(line.station(1).motor.starts == 1, "not one start")
    for setting, weather in (("on", "echo"), ("detect", "echo"), ("off", "echo"), ("on", "clean")):
        for paced in (True, False):
            _check_absent_drive(at, setting, weather, paced)
    for setting in ("on", "detect", "off"):
        _check_frame_not_received(at, setting)
    _check_unconfigured_echo(at)


def _check_absent_drive(at: CellRun, setting: str, weather: str, paced: bool) -> None:
    """A write to a drive that is not there is acknowledged by nobody, be the setting right or wrong.

    Where the port can't tell when its last bit is out (TCP), an echo comes where a reply is waited for.
    """
    line = at.bus(1, echo=setting, line_quality=weather)
    line.bus.core.has_line_timing, line.oracle.frame_rules.misled_drives = paced, not paced
    notation = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}[at.kind.model]
    saves = at.kind.model in ("dzb100", "df800")  # T21: else a RAM write, whose echo has a reply's length in C320
    commands: dict[str, tuple[Any, ...]] = {
        "write": ({notation: 7.0}, saves),
        "set_frequency": (at.random_hz(),),
        "reset_fault": (),
        "run": (at.random_hz(),),
        "stop": (),
    }
    for address, (what, arguments) in enumerate(
        commands.items(), ABSENT_ADDRESS
    ):  # one that failed once is not believed anyway
        _check_not_confirmed(line, line.add_absent(address), what, *arguments)


def _check_not_confirmed(line: MatrixBus, address: int, what: str, *arguments: Any) -> None:
    command = line.command_to_end(address, what, *arguments)
    line.expect(command.result_word not in COMPLETED_WORDS, f"{what} is {command.result_word} by an echo")


def _check_frame_not_received(at: CellRun, setting: str) -> None:
    """The drive is there and does not hear the very frame that acts: its echo is no answer of the drive."""
    line = at.bus(1, echo=setting, line_quality="echo")
    with suppress(DrivebusError):
        line.loop.run_until_complete(line.drives[1].preflight())
    tricks = [line.manipulate_replies(1, "deaf", does=does) for does in (RequestEffect.SETTING, RequestEffect.STOP)]
    _check_not_confirmed(line, 1, "set_frequency", at.random_hz())
    line.station(1).keypad_run(at.random_hz())
    line.run(1.0)
    _check_not_confirmed(line, 1, "stop")
    line.expect(line.drives[1].stop_pending and line.station(1).motor.energised, "given up, or stopped unheard")
    for trick in tricks:
        trick.remaining = 0
    line.run(8.0)
    line.expect(not line.station(1).motor.energised, "it hears the stop, and runs")


def _check_unconfigured_echo(at: CellRun) -> None:
    """An echo that nobody was told of: what is believed all the same is the drive's own answer."""
    line, hz = at.bus(1, echo="off", line_quality="echo"), at.random_hz()
    for _ in range(3):
        answer = line.read(1)
        line.expect(answer.error is not None or answer.received == line.replies[-1].data, f"believed: {answer}")
        line.run(1.5)
    command = line.command_to_end(1, "set_frequency", hz)
    station = line.station(1)
    held = station.bus_hz if at.kind.model == "df800" else station.setpoint_hz
    line.expect(
        command.result_word not in COMPLETED_WORDS or abs(held - hz) < 0.006,
        f"set_frequency {command.result_word}, the drive holds {held}",
    )
