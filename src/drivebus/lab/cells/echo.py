"""Row of the table: the adapter gives our own bytes back."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line
from drivebus.lab.manual import Does

DONE = ("confirmed", "acknowledged")
ABSENT = 9


@case("echo")
def own_echo(at: Case) -> None:
    """Removed where the adapter is known to echo; where the setting is wrong, nothing is believed. Never an answer."""
    for setting in ("on", "detect"):
        line = at.line(1, echo=setting, weather="echo")
        answer = line.read(1)
        line.expect(answer.error is None and answer.received == line.said[-1].data, f"echo {setting}: {answer}")
        wish = line.do(1, "run", at.hz())
        line.expect(wish.word == ("confirmed" if at.kind.tells else "acknowledged"), f"echo {setting}: run {wish.word}")
        line.expect(line.station(1).motor.starts == 1, "not one start")
    for setting, weather in (("on", "echo"), ("detect", "echo"), ("off", "echo"), ("on", "clean")):
        for paced in (True, False):
            _nobody_there(at, setting, weather, paced)
    for setting in ("on", "detect", "off"):
        _unheard(at, setting)
    _wrongly_off(at)


def _nobody_there(at: Case, setting: str, weather: str, paced: bool) -> None:
    """G19: a write to a drive that is not there is acknowledged by nobody, be the setting right or wrong.

    Where the port can't tell when its last bit is out (TCP), an echo comes where a reply is waited for.
    """
    line = at.line(1, echo=setting, weather=weather)
    line.bus.core.paced, line.witness.conduct.misled = paced, not paced
    notation = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}[at.kind.model]
    saves = at.kind.model in ("dzb100", "df800")  # T21: else a RAM write, whose echo has a reply's length in C320
    wishes: dict[str, tuple[Any, ...]] = {
        "write": ({notation: 7.0}, saves),
        "set_frequency": (at.hz(),),
        "reset_fault": (),
        "run": (at.hz(),),
        "stop": (),
    }
    for address, (what, arguments) in enumerate(wishes.items(), ABSENT):  # one that failed once is not believed anyway
        _no_word(line, line.absent(address), what, *arguments)


def _no_word(line: Line, address: int, what: str, *arguments: Any) -> None:
    wish = line.do(address, what, *arguments)
    line.expect(wish.word not in DONE, f"{what} is {wish.word} by an echo")


def _unheard(at: Case, setting: str) -> None:
    """The drive is there and does not hear the very frame that acts: its echo is no answer of the drive."""
    line = at.line(1, echo=setting, weather="echo")
    with suppress(DrivebusError):
        line.loop.run(line.drives[1].preflight())
    tricks = [line.trick(1, "deaf", does=does) for does in (Does.SET, Does.STOP)]
    _no_word(line, 1, "set_frequency", at.hz())
    line.station(1).press_run(at.hz())
    line.run(1.0)
    _no_word(line, 1, "stop")
    line.expect(line.drives[1].stop_pending and line.station(1).motor.energised, "given up, or stopped unheard")
    for trick in tricks:
        trick.times = 0
    line.run(8.0)
    line.expect(not line.station(1).motor.energised, "it hears the stop, and runs")


def _wrongly_off(at: Case) -> None:
    """An echo that nobody was told of: what is believed all the same is the drive's own answer."""
    line, hz = at.line(1, echo="off", weather="echo"), at.hz()
    for _ in range(3):
        answer = line.read(1)
        line.expect(answer.error is not None or answer.received == line.said[-1].data, f"believed: {answer}")
        line.run(1.5)
    wish = line.do(1, "set_frequency", hz)
    station = line.station(1)
    held = station.bus_hz if at.kind.model == "df800" else station.setpoint_hz
    line.expect(wish.word not in DONE or abs(held - hz) < 0.006, f"set_frequency {wish.word}, the drive holds {held}")
