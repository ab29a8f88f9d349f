"""Commands on a drive that answers late or twice, or whose first replies are lost: they say so, or read it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from itertools import count
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus import i18n
from drivebus.cli import connect
from drivebus.cli.commands.read import _read_again
from drivebus.cli.commands.status import _read_status
from drivebus.cli.connect import LATE_REPLY_WAIT_S
from drivebus.cli.errors import ExitCode, error_hint
from drivebus.cli.main import cli
from drivebus.cli.tui.service_source import remote_drive_row
from drivebus.drives.state import DriveStatus
from drivebus.errors import DrivebusError
from drivebus.simulator.port import simulated_bus_of
from drivebus.simulator.wire import Transmission, Wire
from drivebus.values import Reading
from fixtures.drives import MODELS, SimulatedDrives, run_virtual
from fixtures.service import running_service

LATE_S = 0.4  # later than each of these models is expected to reply


def impair_replies(bench: SimulatedDrives, *, delay_s: float = 0.0, lost: int = 0) -> None:
    """Send all replies ``delay_s`` late, and lose the first ``lost`` of them."""
    wire, numbers = simulated_bus_of(bench.port).wire, count()
    transmit = wire.transmit_reply

    def transmit_impaired(source: object, data: bytes, now: float, at: float) -> Transmission:
        sent = transmit(source, data, now, at + delay_s)
        if next(numbers) < lost:
            sent.dropped.update(range(len(data)))
        return sent

    wire.transmit_reply = transmit_impaired  # type: ignore[method-assign]


def first_status(model: str, **impairment: Any) -> DriveStatus:
    async def scenario() -> DriveStatus:
        async with SimulatedDrives(model) as bench:
            impair_replies(bench, **impairment)
            return await _read_status(bench.drive())

    return run_virtual(scenario())


@pytest.mark.parametrize("model", MODELS)
def test_a_drive_that_answers_late_from_its_first_reply_on_is_called_late_and_not_offline(model: str) -> None:
    """The command had ended before the first reply came, so only its hint named the reply delay."""
    with pytest.raises(DrivebusError) as caught:
        first_status(model, delay_s=LATE_S)
    assert caught.value.key == "bus.late_reply"
    assert 0 < caught.value.params["milliseconds"] <= LATE_S * 1000 + 200
    assert "reply delay is longer" in (error_hint(caught.value) or "")


@pytest.mark.parametrize("model", MODELS)
def test_a_drive_whose_first_replies_are_missing_has_its_status_a_second_later(model: str) -> None:
    """Two frames lost on a noisy bus ended the command with the advice to check address, baud rate and wiring."""
    status = first_status(model, lost=2)
    assert status.unusable_reply is None
    assert any(reading.value is not None for reading in status.readings.values())


def test_a_drive_that_does_not_answer_is_called_offline_and_waited_for_no_longer() -> None:
    async def scenario() -> float:
        async with SimulatedDrives("c320") as bench:
            began_at = bench.bus.now()
            with pytest.raises(DrivebusError) as caught:
                await _read_status(bench.drive(9))
            assert caught.value.key == "bus.offline"
            return bench.bus.now() - began_at

    assert LATE_REPLY_WAIT_S < run_virtual(scenario()) < LATE_REPLY_WAIT_S + 2.0


@pytest.mark.parametrize(("model", "name"), [("c320", "F0.1"), ("vc660", "F00.01")])
@pytest.mark.parametrize(("delay_s", "address", "key"), [(LATE_S, 1, "bus.late_reply"), (0.0, 9, "bus.offline")])
def test_a_read_without_reply_names_the_reason(model: str, name: str, delay_s: float, address: int, key: str) -> None:
    """Its table had "no usable reply", without anything to check."""

    async def scenario() -> DrivebusError | None:
        async with SimulatedDrives(model) as bench:
            impair_replies(bench, delay_s=delay_s)
            drive = bench.drive(address)
            await drive.read([name])
            return (await _read_again(drive, [name]))[1]

    error = run_virtual(scenario())
    assert error is not None and error.key == key and error_hint(error)


def test_a_read_that_is_answered_a_second_later_has_its_values_and_no_error() -> None:
    async def scenario() -> tuple[dict[str, Reading], DrivebusError | None]:
        async with SimulatedDrives("c320") as bench:
            impair_replies(bench, lost=1)
            drive = bench.drive()
            assert (await drive.read(["F0.1"]))["F0.1"].value is None
            return await _read_again(drive, ["F0.1"])

    readings, error = run_virtual(scenario())
    assert (readings["F0.1"].value, error) == (2, None)


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_a_read_whose_first_two_replies_are_lost_shows_the_value_without_an_error(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """Beside the value stood that the station is offline, and the advice to check the wiring, with exit code 0."""
    numbers, transmit = count(), Wire.transmit_reply

    def lose_first_two(wire: Wire, source: object, data: bytes, now: float, at: float) -> Transmission:
        sent = transmit(wire, source, data, now, at)
        if next(numbers) < 2:
            sent.dropped.update(range(len(data)))
        return sent

    monkeypatch.setattr(Wire, "transmit_reply", lose_first_two)
    result = CliRunner().invoke(cli, ["read", "sim://c320@1", "F0.1", "--model", "c320", "--address", "1", *words])
    assert next(numbers) > 2
    assert (result.exit_code, result.stderr) == (ExitCode.DONE, "")
    if words:
        document = json.loads(result.stdout)
        assert (document["values"][0]["value"], document["error"]) == (2, None)


ON_VC660 = ("sim://vc660@3", "--model", "vc660", "--address")
READING_COMMANDS = {"read": ("F00.01",), "status": ()}
"""Commands that only read, and their words: a parameter as in the manual of the VC660 (``docs/protocols/vc660.md``)."""
OTHER_COMMANDS = {
    "coast": (),
    "hold-ramp": ("5",),
    "loopback": (),
    "pause": (),
    "reset": (),
    "run": ("--frequency", "5", "--detach"),
    "set-frequency": ("5",),
    "stop": (),
    "write": ("F00.02=1", "--save"),
}


def words_of(command: str, address: int) -> list[str]:
    words = (READING_COMMANDS | OTHER_COMMANDS)[command]
    return [command, ON_VC660[0], *words, *ON_VC660[1:], str(address), "--json"]


def error_of(command: str, result: Result) -> dict[str, Any]:
    document = result.stdout if command == "read" else result.stdout.splitlines()[-1]  # it prints one over many lines
    error: dict[str, Any] = json.loads(document)["error"]
    return error


def send_replies_late(monkeypatch: pytest.MonkeyPatch, delay_s: float) -> None:
    transmit = Wire.transmit_reply
    monkeypatch.setattr(
        Wire, "transmit_reply", lambda wire, source, data, now, at: transmit(wire, source, data, now, at + delay_s)
    )


@pytest.mark.usefixtures("commands_in_virtual_time")
@pytest.mark.parametrize("command", READING_COMMANDS)
def test_a_command_whose_replies_come_late_names_them_with_their_remedy(
    monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """It called the drive offline, with the advice to check address, baud rate and wiring."""
    send_replies_late(monkeypatch, 0.6)
    result = CliRunner().invoke(cli, words_of(command, 3))
    error = error_of(command, result)
    assert (error["key"], error["hint"] in result.stderr.replace("\n", " ")) == ("bus.late_reply", True)
    assert result.exit_code == ExitCode.FAILED


@pytest.mark.usefixtures("commands_in_virtual_time")
@pytest.mark.parametrize("command", OTHER_COMMANDS)
def test_a_command_that_does_more_than_read_waits_for_no_late_reply_because_a_stop_may_follow(
    monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """For a second more the port was in use: a stop of another terminal was not sent."""

    async def unexpected(read: Any) -> None:
        pytest.fail("waits for a late reply")

    monkeypatch.setattr(connect, "read_again_later", unexpected)
    send_replies_late(monkeypatch, 0.6)
    assert CliRunner().invoke(cli, words_of(command, 3)).exit_code in (ExitCode.FAILED, ExitCode.UNKNOWN)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("command", READING_COMMANDS)
def test_a_signal_ends_the_wait_for_a_late_reply_at_once(
    monkeypatch: pytest.MonkeyPatch, command: str, number: signal.Signals
) -> None:
    """SIGTERM killed the command without a sentence or an exit code."""
    wait_s, sleep = 30.0, asyncio.sleep

    async def interrupted_sleep(seconds: float) -> None:
        if seconds == wait_s:
            os.kill(os.getpid(), number)
        await sleep(seconds)

    monkeypatch.setattr(connect, "LATE_REPLY_WAIT_S", wait_s)
    monkeypatch.setattr("asyncio.sleep", interrupted_sleep)
    began_at = time.monotonic()
    result = CliRunner().invoke(cli, words_of(command, 9))
    assert result.exit_code == ExitCode.INTERRUPTED
    assert time.monotonic() - began_at < wait_s / 2


def send_replies_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    transmit = Wire.transmit_reply

    def transmit_twice(wire: Wire, source: object, data: bytes, now: float, at: float) -> Transmission:
        sent = transmit(wire, source, data, now, at)
        transmit(wire, source, data, now, at + 0.03)
        return sent

    monkeypatch.setattr(Wire, "transmit_reply", transmit_twice)


def test_the_live_view_says_that_replies_come_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its state was "unknown", without a reason."""
    send_replies_twice(monkeypatch)
    words = ["monitor", "sim://vc660@3", "--model", "vc660", "--address", "3", "--json", "--period", "1"]
    result = CliRunner().invoke(cli, [*words, "--duration", "4"])
    documents = map(json.loads, result.stdout.splitlines())
    reasons = {document["drives"][0]["reason"] for document in documents if "drives" in document}
    assert i18n.text("drives.duplicate", "en", station=3) in reasons


def test_the_live_view_of_a_service_says_likewise(monkeypatch: pytest.MonkeyPatch) -> None:
    send_replies_twice(monkeypatch)

    async def scenario() -> set[str | None]:
        async with running_service() as kit:
            reasons = set()
            for _ in range(10):
                await asyncio.sleep(1.0)
                reasons.add(remote_drive_row(await kit.call("drives.get", drive="pump-1"), 0.0).reason)
            return reasons

    assert i18n.text("drives.duplicate", "en", station=1) in run_virtual(scenario())


def test_the_document_of_a_failed_read_has_the_reason() -> None:
    """It stood on standard error only, and each value had ``no usable reply``."""
    words = ["read", "sim://c320@1", "F0.1", "--model", "c320", "--address", "9", "--json"]
    result = CliRunner().invoke(cli, words)
    error = json.loads(result.stdout)["error"]
    assert (result.exit_code, error["key"], error["params"]["station"]) == (ExitCode.FAILED, "bus.offline", 9)
    assert error["hint"]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("command", [["status"], ["read", "F0.1"]])
def test_the_remedy_for_a_drive_that_is_offline_is_no_command_that_prints_the_same(
    command: list[str], language: str
) -> None:
    """``drivebus status`` sent its reader to ``drivebus status``."""
    words = [command[0], "sim://c320@1", *command[1:], "--model", "c320", "--address", "9", "--lang", language]
    shown = " ".join(CliRunner().invoke(cli, words, env={"COLUMNS": "400"}).stderr.split())
    assert "drivebus scan" in shown and "drivebus status" not in shown


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_command_read_prints_the_reason_and_the_remedy(language: str) -> None:
    words = ["read", "sim://c320@1", "F0.1", "--model", "c320", "--address", "9", "--lang", language]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == ExitCode.FAILED
    assert i18n.text("bus.offline", language, station=9) in result.stderr
    assert i18n.text("hint.bus.offline", language) in result.stderr
