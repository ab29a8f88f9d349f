"""Output of an attached run about its drive."""

from __future__ import annotations

import asyncio
import contextlib
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n, profiles
from drivebus.cli import output
from drivebus.cli.commands import run
from drivebus.cli.commands.run import _progress_printer, _watch
from drivebus.cli.errors import ExitCode, error_hint
from drivebus.cli.main import cli
from drivebus.cli.run_watch import RunWatch
from drivebus.cli.signals import ShutdownSignal
from drivebus.drives.operations import start
from drivebus.drives.outcome import Outcome, OutcomeStatus, raise_for_status
from drivebus.drives.state import Direction, DriveState, DriveStatus, Fault
from drivebus.errors import ChecksumError, ControlNotHeld, DrivebusError, Expired, NotFound, PortLost
from drivebus.values import Text

ATTACHED = "Attached: Ctrl-C stops the drive"
DETACHED = "Detached. A sim:// drive ends with this command"


@pytest.mark.parametrize(
    ("words", "code", "shown"),
    [
        (("--frequency", "5"), 130, [ATTACHED]),
        (("--frequency", "5", "--detach"), 0, [DETACHED]),
        (("--frequency", "500"), 1, []),
        (("--frequency", "500", "--detach"), 1, []),
    ],
)
def test_only_a_drive_that_was_started_is_called_attached_or_detached(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], code: int, shown: list[str]
) -> None:
    async def interrupted(*_: object) -> ExitCode:
        return ExitCode.INTERRUPTED

    monkeypatch.setattr(run, "_watch", interrupted)
    drive = ("sim://c320@1?ramp=1", "--model", "c320", "--address", "1", "--lang", "en")
    found = CliRunner().invoke(cli, ["run", *drive, *words], env={"COLUMNS": "200"})
    assert found.exit_code == code, found.output
    assert [text for text in (ATTACHED, DETACHED) if text in found.stdout] == shown


@pytest.mark.parametrize(
    ("url", "key"),
    [("/dev/ttyUSB0", "run.detached"), ("tcp://h:1", "run.detached"), ("sim://c320@1", "run.detached_simulated")],
)
def test_a_detached_run_says_that_only_a_simulated_drive_ends_with_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], url: str, key: str
) -> None:
    """A ``sim://`` drive was reported to keep running, and the next command met one that stands still."""

    async def start(*_: object) -> ExitCode:
        return ExitCode.DONE

    monkeypatch.setattr(run, "_start", start)
    bus: Any = SimpleNamespace(port=SimpleNamespace(url=url))
    chosen = run.RunOptions(frequency_hz=5.0, direction=None, wait=False, detach=True)
    assert asyncio.run(run._start_and_watch(bus, Any, ShutdownSignal(), chosen)) is None  # type: ignore[arg-type]
    assert capsys.readouterr().out.strip() == i18n.text(key, "en")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_start_whose_checks_took_too_long_names_what_prolongs_them(language: str) -> None:
    """On a line with late replies each start was refused, without a next step."""
    output.parse_global_options(["--lang", language])
    hint = error_hint(Expired("drives.checks_timeout", age_s=6.1, limit_s=5.0))
    assert hint == i18n.text("hint.drives.checks_timeout", language) and "drivebus monitor" in hint


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("remote", [False, True])
def test_an_attached_run_says_what_stops_the_motor_where_this_computer_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], remote: bool, language: str
) -> None:
    """Regression: it named Ctrl-C and the terminal, which stop nothing once the adapter or the computer has failed."""

    async def start(*_: object, **__: object) -> Outcome:
        return Outcome(status=OutcomeStatus.CONFIRMED, key="drives.run_at_zero")

    monkeypatch.setattr(run, "_is_remote", lambda drive: remote)
    output.parse_global_options(["--lang", language])
    chosen = run.RunOptions(frequency_hz=5.0, direction=None, wait=False, detach=False)
    drive: Any = SimpleNamespace(run=start)
    bus: Any = FakeBus()
    assert asyncio.run(run._start(bus, drive, ShutdownSignal(), chosen)) is ExitCode.DONE
    expected = i18n.text("run.attached_service" if remote else "run.attached", language)
    assert "".join(expected.split()) in "".join(capsys.readouterr().out.split())


class FakeBus:
    @staticmethod
    def now() -> float:
        return 0.0


class FakeDrive:
    """Drive that reports these statuses, or fails with these errors, one after the other."""

    profile = profiles.load("c320")

    def __init__(self, *statuses: DriveStatus | DrivebusError) -> None:
        self._statuses = iter(statuses)

    async def status(self) -> DriveStatus:
        found = next(self._statuses)
        if isinstance(found, DrivebusError):
            raise found
        return found


def watch(*statuses: DriveStatus | DrivebusError, language: str = "en") -> ExitCode:
    output.parse_global_options(["--lang", language])
    bus: Any = FakeBus()
    drive: Any = FakeDrive(*statuses)
    return asyncio.run(_watch(bus, drive, ShutdownSignal(), RunWatch(10.0, Direction.FORWARD, bus.now())))


def test_a_trip_is_printed_with_its_code_and_text(capsys: pytest.CaptureFixture[str]) -> None:
    fault = Fault(9, "E009", Text("over-current", "过电流"))
    assert watch(DriveStatus(state=DriveState.FAULT, fault=fault)) is ExitCode.FAILED
    assert "The drive tripped: E009 over-current." in capsys.readouterr().out


def test_a_drive_that_turns_round_is_remarked_on(capsys: pytest.CaptureFixture[str]) -> None:
    reverse = DriveStatus(state=DriveState.RUNNING, direction=Direction.REVERSE)
    off = DriveStatus(state=DriveState.STOPPED)
    assert watch(reverse, off, off) is ExitCode.FAILED
    shown = capsys.readouterr().out
    assert "commanded forward, the drive reports reverse" in shown
    assert i18n.text("run.off_by_itself") in " ".join(shown.split())


@pytest.mark.parametrize(
    ("statuses", "is_off"),
    [
        ([DriveStatus(state=DriveState.STOPPED)] * 2, True),
        ([DriveStatus(state=DriveState.FAULT, fault=Fault(9, "E009", Text("", "")))] * 2, False),
        ([DriveStatus(state=DriveState.STOPPED), DriveStatus(state=DriveState.RUNNING)], False),
    ],
)
def test_a_drive_is_called_off_by_itself_after_two_reads_in_a_row_without_a_trip(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, statuses: list[DriveStatus], is_off: bool
) -> None:
    monkeypatch.setattr(run, "STATUS_PERIOD_S", 0.0)
    with contextlib.suppress(RuntimeError):  # no further status
        watch(*statuses)
    assert (i18n.text("run.off_by_itself") in " ".join(capsys.readouterr().out.split())) is is_off


@pytest.mark.parametrize(
    ("language", "expected"),
    [
        ("en", "It is not known whether the motor runs, and no stop can be sent. Use the hard-wired stop."),
        ("zh", "电机是否在运行未知，也无法发送停机命令。请使用硬接线停机。"),
    ],
)
def test_a_lost_port_says_once_that_the_motor_may_run_and_when_the_state_is_known_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, language: str, expected: str
) -> None:
    monkeypatch.setattr(run, "STATUS_PERIOD_S", 0.0)
    lost = PortLost("ports.lost", port="/dev/ttyUSB0", reason="unplugged")
    off = DriveStatus(state=DriveState.STOPPED)
    assert watch(*[lost] * 16, off, off, language=language) is ExitCode.FAILED
    shown = capsys.readouterr().out.replace("\n", "" if language == "zh" else " ")
    assert (shown.count(expected), shown.count("/dev/ttyUSB0")) == (1, 1)
    assert i18n.text("run.known_again", language, seconds=0.0) in shown


def test_damaged_replies_while_attached_are_remarked_on_and_the_run_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a missing reply: the motor turns, and an end of the command without a stop would leave it so."""
    monkeypatch.setattr(run, "STATUS_PERIOD_S", 0.0)
    damaged = ChecksumError("modbus.crc", expected=1, found=2)
    off = DriveStatus(state=DriveState.STOPPED)
    assert watch(*[damaged] * 3, off, off) is ExitCode.FAILED
    shown = capsys.readouterr().out.replace("\n", " ")
    assert (shown.count("ATTENTION: no usable reply"), i18n.text("run.known_again", "en", seconds=0.0) in shown) == (
        1,
        True,
    )


@pytest.mark.parametrize(
    "error", [ChecksumError("modbus.crc", expected=1, found=2), NotFound("plant.no_drive", id="fan-1", known="fan-2")]
)
def test_whatever_ends_an_attached_run_is_followed_by_a_stop(
    monkeypatch: pytest.MonkeyPatch, error: DrivebusError
) -> None:
    """Before the start these errors need none, so that they were not followed by one after it either."""

    async def failing(*_: object) -> ExitCode:
        raise error

    monkeypatch.setattr(run, "_watch", failing)
    line = "run sim://c320@1?ramp=1 --model c320 --address 1 --frequency 5 --lang en"
    found = CliRunner().invoke(cli, line.split(), env={"COLUMNS": "200"})
    assert found.exit_code != ExitCode.DONE and "Confirmed: the drive reports stopped" in found.stdout, found.output


def test_an_attached_run_whose_drive_another_user_takes_over_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other user commands the drive from then on."""

    async def failing(*_: object) -> ExitCode:
        raise ControlNotHeld("plant.not_owner", drive="fan-1", owner="bob")

    monkeypatch.setattr(run, "_watch", failing)
    line = "run sim://c320@1?ramp=1 --model c320 --address 1 --frequency 5 --lang en"
    found = CliRunner().invoke(cli, line.split(), env={"COLUMNS": "200"})
    assert (found.exit_code, "Stopping" in found.stdout) == (ExitCode.FAILED, False), found.output


def test_waiting_for_the_speed_shows_the_drive_twice_a_second(capsys: pytest.CaptureFixture[str]) -> None:
    times = iter([100.0, 100.0, 100.2, 100.4, 100.6, 100.6, 100.7])
    bus: Any = SimpleNamespace(now=lambda: next(times, 100.7))
    drive: Any = FakeDrive()
    show = _progress_printer(bus, drive)
    for _ in range(4):
        show(DriveStatus(state=DriveState.ACCELERATING, direction=Direction.FORWARD))
    assert capsys.readouterr().out.count("accelerating, forward") == 2


@pytest.mark.parametrize("key", ["drives.not_started", "drives.setpoint_unknown"])
@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_frequency_that_may_not_have_arrived_is_answered_with_the_next_step(
    monkeypatch: pytest.MonkeyPatch, key: str, language: str
) -> None:
    """``the start was not sent: 10.0 Hz was sent; it is unknown …`` stood alone, and the motor stood still."""
    unknown = Outcome(status=OutcomeStatus.UNKNOWN, key="drives.setpoint_unknown", params={"frequency_hz": 10.0})
    outcome = unknown if key == unknown.key else start._not_started_outcome(unknown)
    with pytest.raises(DrivebusError) as caught:
        raise_for_status(outcome)
    assert caught.value.key == key
    monkeypatch.setattr(output, "language", lambda: language)
    assert error_hint(caught.value) == i18n.text("hint.drives.setpoint_unknown", language)


@pytest.mark.parametrize(("language", "words"), [("en", "after a communication loss"), ("zh", "若通信曾中断")])
def test_a_drive_that_stands_still_after_an_outage_may_have_stopped_by_itself(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, language: str, words: str
) -> None:
    """Only keypad, terminals and another master were named after the adapter had been pulled out."""
    monkeypatch.setattr(run, "STATUS_PERIOD_S", 0.0)
    running, off = DriveStatus(state=DriveState.RUNNING), DriveStatus(state=DriveState.STOPPED)
    lost = PortLost("ports.lost", port="/dev/ttyUSB0", reason="unplugged")
    assert watch(running, *[lost] * 4, off, off, language=language) is ExitCode.FAILED
    shown = capsys.readouterr().out.replace("\n", "" if language == "zh" else " ")
    assert "/dev/ttyUSB0" in shown and words in shown
