"""``prove`` at simulated drives, with a person who presses keys: nothing moves or is written before a y (T08, T16)."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli import output
from drivebus.cli.commands import calibrate
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.errors import ConfigurationError, StopUnconfirmed
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.testing import virtual_time
from fixtures.child_process import PtyTerminal


class Person:
    """Presses the next of ``keys`` at each question; what comes before a key is done first."""

    def __init__(self, *keys: str | Callable[[], str | None]) -> None:
        self.keys = list(keys)
        self.asked: list[int] = []

    def clear(self) -> None:
        self.asked.append(station().motor.starts)

    async def get(self, timeout_s: float | None = None) -> str | None:
        key = self.keys.pop(0)
        return key() if callable(key) else key


def station() -> Any:
    """As it was at its last frame, also when its time is over."""
    return find_simulated_bus("prove").stations[0]


@pytest.fixture(autouse=True)
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Simulated drives are remembered as real ones are; the terminal is one."""
    monkeypatch.setattr("drivebus.drives.drive.VOLATILE_SCHEMES", ())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    output.parse_global_options(["--lang", "en"])
    yield
    output.parse_global_options([])
    clear_simulated_buses()


def proved(
    monkeypatch: pytest.MonkeyPatch, model: str, person: Person, *options: str, before: Callable[[], None] | None = None
) -> ExitCode:
    @contextmanager
    def reading() -> Iterator[Person]:
        if before is not None:
            before()
        yield person

    monkeypatch.setattr("drivebus.cli.keyboard.raw_keyboard", reading)
    clear_simulated_buses()
    port = f"sim://{model}@1?" + "&".join(("name=prove", "ramp=1", *options))
    return virtual_time.run(calibrate._calibrate(Target(port=port, model=model, address=1)))


def turn_keypad() -> str:
    station().setpoint_hz = 12.3
    return "y"


@pytest.mark.parametrize("coding", ["hex-0.1", "decimal-0.1"])
def test_t08_a_dzb100_is_proved_step_by_step_and_remembered(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], coding: str
) -> None:
    person = Person(turn_keypad, "y")
    options = (f"setpoint_coding={coding}", f"query_coding={coding}")
    assert proved(monkeypatch, "dzb100", person, *options) is ExitCode.DONE
    assert person.asked == [0, 0], "asked before the first motion"
    assert station().motor.starts > 0 and not station().motor.energised
    text = capsys.readouterr().out
    assert f"query_coding = {coding}" in text and f"setpoint_coding = {coding}" in text and "Stored" in text
    no_user = Person()
    assert proved(monkeypatch, "dzb100", no_user, *options) is ExitCode.DONE
    assert "Nothing is left to calibrate" in capsys.readouterr().out and not no_user.asked


@pytest.mark.parametrize("keys", [("n",), (turn_keypad, "n"), (turn_keypad, "\r"), (turn_keypad, lambda: None)])
def test_whatever_is_not_y_moves_nothing(
    monkeypatch: pytest.MonkeyPatch, keys: tuple[str | Callable[[], str | None], ...]
) -> None:
    assert proved(monkeypatch, "dzb100", Person(*keys)) is ExitCode.INTERRUPTED
    assert station().motor.starts == 0


@pytest.mark.parametrize(("field", "key"), [("b3b2", "f"), ("b2b3", "r")])
def test_a_df800s_direction_is_what_the_person_saw(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], field: str, key: str
) -> None:
    turned: list[float] = []

    def watch() -> None:
        direct = station().run_towards
        station().run_towards = lambda hz: (direct(hz), turned.append(station().motor.target_hz))[0]

    def say() -> str:
        assert (turned[0] > 0) == (key == "f") and not station().motor.energised, "asked once it stands"
        return key

    options = (f"direction_field={field}",)
    assert proved(monkeypatch, "df800", Person("y", say), *options, before=watch) is ExitCode.DONE
    assert f"direction_field = {field}" in capsys.readouterr().out
    assert proved(monkeypatch, "df800", Person()) is ExitCode.DONE, "it is remembered"


def test_who_saw_nothing_proves_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert proved(monkeypatch, "df800", Person("y", "?")) is ExitCode.FAILED
    assert "nothing is stored" in capsys.readouterr().out
    assert station().motor.starts == 1
    assert proved(monkeypatch, "df800", Person("n")) is ExitCode.INTERRUPTED, "asked again"


def test_a_df800_is_not_written_before_the_y(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []

    def no() -> str:
        seen.append(station().setpoint_hz)
        return "n"

    proved(monkeypatch, "df800", Person(no), before=lambda: setattr(station(), "setpoint_hz", 33.0))
    assert seen == [33.0] and station().setpoint_hz == 33.0


def test_a_model_without_open_proofs_is_asked_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert proved(monkeypatch, "c320", Person()) is ExitCode.DONE
    assert "Nothing is left to calibrate on this c320" in capsys.readouterr().out


def test_ctrl_c_in_a_proof_that_moves_stops_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end comes while the motor turns; the stop is confirmed before the verb returns."""
    import asyncio

    from drivebus.cli import signals

    received: list[signals.ShutdownSignal] = []
    listening = signals.shutdown_signals

    @contextmanager
    def noted() -> Iterator[signals.ShutdownSignal]:
        with listening() as found:
            received.append(found)
            yield found

    def start_and_interrupt() -> str:
        async def soon() -> None:
            await asyncio.sleep(1.5)
            assert station().motor.energised, "in the middle of the run"
            received[0].request("SIGINT")

        tasks.append(asyncio.ensure_future(soon()))
        return "y"

    tasks: list[Any] = []
    monkeypatch.setattr(signals, "shutdown_signals", noted)
    assert proved(monkeypatch, "dzb100", Person(turn_keypad, start_and_interrupt)) is ExitCode.INTERRUPTED
    assert station().motor.starts == 1 and not station().motor.energised


def test_a_drive_that_falls_silent_while_it_turns_is_stopped_and_said_to_be_unconfirmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def silence() -> str:
        direct = station().run_towards

        def deaf(hz: float) -> None:
            direct(hz)
            station().faults.mute = True

        station().run_towards = deaf
        return "y"

    with pytest.raises(StopUnconfirmed):
        proved(monkeypatch, "dzb100", Person(turn_keypad, silence))
    assert not station().motor.energised, "mute, not deaf: the stop reached it"


@pytest.mark.skipif(sys.platform == "win32", reason="ptys of POSIX")
def test_at_a_terminal_each_step_waits_for_its_key() -> None:
    with PtyTerminal("calibrate", "sim://df800@1", "--model", "df800", "--address", "1") as terminal:
        terminal.wait_for("Press y to jog it")
        terminal.press("y")
        terminal.wait_for("In which direction did it turn?")
        terminal.press("f")
        terminal.wait_for("Determined: direction_field = b3b2")
        assert terminal.exit_code() == 0
    assert "is not stored" in terminal.output


def test_without_a_terminal_nothing_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConfigurationError) as caught:
        proved(monkeypatch, "df800", Person())
    assert caught.value.key == "calibrate.no_terminal"
    with pytest.raises(KeyError):
        station()


@pytest.mark.parametrize(("model", "purposes"), [("dzb100", 4), ("df800", 3), ("c320", 0)])
def test_a_dry_run_shows_what_would_be_sent(model: str, purposes: int) -> None:
    words = ["/dev/absent", "--model", model, "--address", "1", "--dry-run", "--json"]
    output.parse_global_options(words)
    result = CliRunner().invoke(calibrate.command, words, standalone_mode=False)
    frames = json.loads(result.stdout)["frames"]
    assert len(frames) == purposes
    if model == "dzb100":
        assert bytes.fromhex(frames[2]["hex"])[7:] == b"0005", "the cap"
