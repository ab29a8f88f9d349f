"""``calibrate`` on simulated drives with simulated keys: no step moves or writes before the key y."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli import connect
from drivebus.cli.commands import calibrate
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.drives.operations.setpoint_step_calibration import STEPS
from drivebus.errors import ConfigurationError, LimitError, StopUnconfirmed
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.testing import virtual_time
from fixtures.child_process import PtyTerminal


class FakeKeys:
    """Key queue that returns the next key at each question; a callable acts first and returns the key."""

    def __init__(self, *keys: str | Callable[[], str | None]) -> None:
        self.keys = list(keys)
        self.starts_at_questions: list[int] = []
        """Number of starts of the motor at each question."""

    def clear(self) -> None:
        self.starts_at_questions.append(station().motor.starts)

    async def get(self, timeout_s: float | None = None) -> str | None:
        key = self.keys.pop(0)
        return key() if callable(key) else key


def station() -> Any:
    """Return the simulated station, also after the end of the command."""
    return find_simulated_bus("calibrate").stations[0]


@pytest.fixture(autouse=True)
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Store results of simulated drives as those of real ones, and pretend to have a terminal."""
    monkeypatch.setattr("drivebus.drives.drive.VOLATILE_SCHEMES", ())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    yield
    clear_simulated_buses()


def run_calibrate(
    monkeypatch: pytest.MonkeyPatch,
    model: str,
    fake: FakeKeys,
    *options: str,
    before: Callable[[], None] | None = None,
    simulated: str | None = None,
    given: tuple[tuple[str, str], ...] = (),
) -> ExitCode:
    """Calibrate a drive as a ``model``; ``simulated`` is the model that it really is, ``given`` are its --option."""

    @contextmanager
    def reading() -> Iterator[FakeKeys]:
        if before is not None:
            before()
        yield fake

    monkeypatch.setattr("drivebus.cli.keyboard.raw_keyboard", reading)
    clear_simulated_buses()
    port = f"sim://{simulated or model}@1?" + "&".join(("name=calibrate", "ramp=1", *options))
    return virtual_time.run(calibrate._calibrate(Target(port=port, model=model, address=1, option=given)))


def turn_keypad() -> str:
    station().setpoint_hz = 12.3
    return "y"


@pytest.mark.parametrize("coding", ["hex-0.1", "decimal-0.1"])
def test_a_dzb100_is_calibrated_step_by_step_and_the_results_are_stored(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], coding: str
) -> None:
    fake = FakeKeys(turn_keypad, "y")
    options = (f"setpoint_coding={coding}", f"query_coding={coding}")
    assert run_calibrate(monkeypatch, "dzb100", fake, *options) is ExitCode.DONE
    assert fake.starts_at_questions == [0, 0], "each question comes before the first motion"
    assert station().motor.starts > 0 and not station().motor.energised
    text = capsys.readouterr().out
    assert f"query_coding = {coding}" in text and f"setpoint_coding = {coding}" in text and "Stored" in text
    unused = FakeKeys()
    assert run_calibrate(monkeypatch, "dzb100", unused, *options) is ExitCode.DONE
    assert "Nothing is left to calibrate" in capsys.readouterr().out and not unused.starts_at_questions


def test_a_misread_calibration_is_named_with_the_way_to_repeat_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Regression: a second calibration only said that nothing is left, after a keypad that was misread too."""
    options = ("setpoint_coding=hex-0.1", "query_coding=hex-0.1")
    run_calibrate(monkeypatch, "dzb100", FakeKeys(turn_keypad, "y"), *options)
    run_calibrate(monkeypatch, "dzb100", FakeKeys(), *options)
    text = capsys.readouterr().out
    assert "setpoint_coding is hex-0.1" in text
    name, _, value = text.rpartition("--option ")[2].strip().partition("=")
    again = FakeKeys("y")
    assert run_calibrate(monkeypatch, "dzb100", again, *options, given=((name, value),)) is ExitCode.DONE
    assert not again.keys and f"Determined: {name} = hex-0.1" in capsys.readouterr().out


def test_a_calibration_whose_output_is_lost_is_done_and_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended with 2, as if nothing had been sent, after the motor had moved."""
    options = ("setpoint_coding=hex-0.1", "query_coding=hex-0.1")
    with monkeypatch.context() as context:

        def fail(text: str, err: bool = False, **_: Any) -> None:
            if not err:
                raise OSError(28, "No space left on device")

        context.setattr("drivebus.cli.output.click.echo", fail)
        assert run_calibrate(monkeypatch, "dzb100", FakeKeys(turn_keypad, "y"), *options) is ExitCode.DONE
    unused = FakeKeys()
    assert run_calibrate(monkeypatch, "dzb100", unused, *options) is ExitCode.DONE
    assert not unused.starts_at_questions, "nothing is left to calibrate"


@pytest.mark.parametrize("keys", [("n",), (turn_keypad, "n"), (turn_keypad, "\r"), (turn_keypad, lambda: None)])
def test_no_key_but_y_starts_the_motor(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    keys: tuple[str | Callable[[], str | None], ...],
) -> None:
    assert run_calibrate(monkeypatch, "dzb100", FakeKeys(*keys)) is ExitCode.INTERRUPTED
    assert station().motor.starts == 0
    option = "query_coding" if keys == ("n",) else "setpoint_coding"
    assert capsys.readouterr().err.endswith(i18n.text("calibrate.not_begun", option=option) + "\n")


@pytest.mark.parametrize(("field", "key"), [("b3b2", "f"), ("b2b3", "r"), ("b3b2", "Ｆ")])
def test_the_direction_of_a_df800_is_the_one_that_the_user_reports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], field: str, key: str
) -> None:
    turned: list[float] = []

    def watch() -> None:
        direct = station().run_towards
        station().run_towards = lambda hz: (direct(hz), turned.append(station().motor.target_hz))[0]

    def answer() -> str:
        assert (turned[0] > 0) == (key in "fＦ") and not station().motor.energised, "asked at standstill"
        return key

    options = (f"direction_field={field}",)
    fake = FakeKeys("ｙ" if key == "Ｆ" else "y", answer)
    assert run_calibrate(monkeypatch, "df800", fake, *options, before=watch) is ExitCode.DONE
    assert f"direction_field = {field}" in capsys.readouterr().out
    assert run_calibrate(monkeypatch, "df800", FakeKeys()) is ExitCode.DONE, "the result is stored"


def test_an_unclear_answer_stores_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The outcome is that of the stop; it was that of the jog: stopped unless it is renewed."""
    assert run_calibrate(monkeypatch, "df800", FakeKeys("y", "?")) is ExitCode.FAILED
    found = capsys.readouterr().out
    assert "nothing is stored" in found
    assert i18n.text("drives.stop_acknowledged") in found
    assert station().motor.starts == 1
    assert run_calibrate(monkeypatch, "df800", FakeKeys("n")) is ExitCode.INTERRUPTED, "the question is repeated"


def test_a_df800_is_not_written_before_the_key_y(monkeypatch: pytest.MonkeyPatch) -> None:
    setpoints: list[float] = []

    def answer_no() -> str:
        setpoints.append(station().setpoint_hz)
        return "n"

    run_calibrate(monkeypatch, "df800", FakeKeys(answer_no), before=lambda: setattr(station(), "setpoint_hz", 33.0))
    assert setpoints == [33.0] and station().setpoint_hz == 33.0


def test_a_calibrated_model_has_no_step_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_calibrate(monkeypatch, "vc660", FakeKeys()) is ExitCode.DONE
    assert "Nothing is left to calibrate on this vc660" in capsys.readouterr().out


def test_each_key_of_the_keypad_question_is_the_first_digit_of_its_frequency() -> None:
    """The keys were 1 and 2: a user who typed the 5 of the keypad was answered that nothing was seen."""
    for language, form in (("en", "[Kk]ey {}: ([0-9.]+) Hz"), ("zh", "按 {}：([0-9.]+) Hz")):
        question = i18n.text("calibrate.ask_keypad_hz", language)
        shown = [re.search(form.format(key), question) for key in STEPS[0].observations]
        assert [match and match[1] for match in shown] == ["0.5", "5"]


@pytest.mark.parametrize(("simulated", "keypad_hz"), [("c320", 0.5), ("e300", 5.0)])
def test_the_keypad_shows_in_which_step_a_c320_counts(
    monkeypatch: pytest.MonkeyPatch, simulated: str, keypad_hz: float
) -> None:
    """A drive at a real port states nothing of itself; what was read is stored, and rejects the wrong model."""
    monkeypatch.setattr("drivebus.simulator.port.SimPort.drive_options", {})
    seen: list[float] = []

    def watch() -> None:
        direct = station().run_towards
        station().run_towards = lambda hz: (direct(hz), seen.append(hz))[0]

    def answer() -> str:
        assert max(seen) == keypad_hz and not station().motor.energised, "asked at standstill"
        return f"{keypad_hz:g}"[0]  # the number is typed as the keypad shows it, and its first digit answers

    fake = FakeKeys("y", answer)
    assert run_calibrate(monkeypatch, "c320", fake, before=watch, simulated=simulated) is ExitCode.DONE
    assert fake.starts_at_questions == [0, 1], "no motion before the key y"

    async def run() -> None:
        async with connect.open_drive(Target(port=f"sim://{simulated}@1?name=calibrate", model="c320", address=1)) as (
            _,
            drive,
        ):
            await drive.run(20.0)
            await drive.stop()

    if simulated == "c320":
        virtual_time.run(run())
        assert max(seen) == 20.0
    else:
        with pytest.raises(LimitError, match="does not fit this drive"):
            virtual_time.run(run())


def test_ctrl_c_during_a_calibration_run_stops_the_drive(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stop is confirmed before the command ends."""
    import asyncio

    from drivebus.cli import signals

    received: list[signals.ShutdownSignal] = []
    original = signals.shutdown_signals

    @contextmanager
    def recording(**options: Any) -> Iterator[signals.ShutdownSignal]:
        with original(**options) as found:
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
    monkeypatch.setattr(signals, "shutdown_signals", recording)
    assert run_calibrate(monkeypatch, "dzb100", FakeKeys(turn_keypad, start_and_interrupt)) is ExitCode.INTERRUPTED
    assert station().motor.starts == 1 and not station().motor.energised
    assert i18n.text("calibrate.ended", option="setpoint_coding") in capsys.readouterr().err


def test_the_stop_of_a_drive_that_goes_offline_while_it_turns_is_unconfirmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def mute_after_start() -> str:
        direct = station().run_towards

        def start_and_mute(hz: float) -> None:
            direct(hz)
            station().faults.mute = True

        station().run_towards = start_and_mute
        return "y"

    with pytest.raises(StopUnconfirmed):
        run_calibrate(monkeypatch, "dzb100", FakeKeys(turn_keypad, mute_after_start))
    assert not station().motor.energised, "the drive executes the stop without a reply"


@pytest.mark.skipif(sys.platform == "win32", reason="ptys of POSIX")
def test_each_step_on_a_terminal_waits_for_its_key() -> None:
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
        run_calibrate(monkeypatch, "df800", FakeKeys())
    assert caught.value.key == "calibrate.no_terminal"
    with pytest.raises(KeyError):
        station()


@pytest.mark.parametrize(
    ("model", "reads", "purposes"), [("dzb100", 4, 4), ("df800", 4, 3), ("c320", 2, 3), ("vc660", 0, 0)]
)
def test_a_dry_run_prints_the_checks_and_the_frames_of_the_open_steps(model: str, reads: int, purposes: int) -> None:
    words = ["calibrate", "/dev/absent", "--model", model, "--address", "1", "--dry-run", "--json"]
    result = CliRunner().invoke(cli, words)
    frames = json.loads(result.stdout)["frames"]
    assert len(frames) == reads + purposes
    if model == "dzb100":
        assert bytes.fromhex(frames[reads + 2]["hex"])[7:] == b"0005", "the cap"
