"""``comm-loss-test``: test and record what a drive of a running service does at a communication loss."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING

from drivebus.cli import options, output
from drivebus.cli.background_output import background_output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.drive_command import must_stop_after, stop_and_print
from drivebus.cli.errors import ExitCode, report_error
from drivebus.cli.prompts import confirm
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.cli.remote.drive import RemoteDrive

TEST_POLL_PERIOD_S = 0.5  # between two reads of the result of the test


def _test(*, service: str, drive: str, frequency: float, silence: float | None, yes: bool) -> ExitCode:
    """Run the test. Raises ConfigurationError where no terminal can confirm the start, unless ``yes``."""
    from drivebus.errors import ConfigurationError

    if not yes and not sys.stdin.isatty():
        raise ConfigurationError("comm_loss_test.not_confirmed")
    with background_output():
        return asyncio.run(_connect_and_test(service, drive, frequency, silence, yes=yes))


async def _connect_and_test(
    service: str, name: str, frequency_hz: float, silence_s: float | None, *, yes: bool
) -> ExitCode:
    """Ask, start the test and wait for its result; a stop follows whatever ends it before."""
    from drivebus import profiles
    from drivebus.cli.remote.client import open_client
    from drivebus.cli.remote.drive import RemoteBus, RemoteDrive
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import DrivebusError
    from drivebus.service.api.operations.drives import DRIVES_GET

    async with open_client(service) as client:
        view = await client.call(DRIVES_GET.name, {"drive": name})
        question = output.text("comm_loss_test.confirm", drive=name, frequency_hz=f"{frequency_hz:g}")
        if not yes and not confirm(question):
            return ExitCode.INTERRUPTED
        drive = RemoteDrive(client, name, view["address"], profiles.load(view["model"]))
        with shutdown_signals(may_suspend=False) as shutdown:
            try:
                started = await _start(drive, frequency_hz, silence_s)
                with output.continue_without_output():  # the motor runs: only its stop may end the test
                    output.print_note("comm_loss_test.started", seconds=f"{started['silence_s']:g}")
                try:
                    found = await shutdown.interruptible(_result(drive))
                except DrivebusError as error:
                    return await stop_and_print(RemoteBus(), drive, report_error(error))
                if shutdown.received or found is None:
                    return await stop_and_print(RemoteBus(), drive, ExitCode.INTERRUPTED)
            finally:
                await drive.close()
        with output.continue_without_output():  # it is over, and recorded
            return _print_result(name, found, view["comm_loss"]["tested"])


async def _start(drive: RemoteDrive, frequency_hz: float, silence_s: float | None) -> Json:
    """Start the test. Where it fails and its motor may be running, the drive is stopped before the error is raised."""
    try:
        return await drive.test_comm_loss(frequency_hz, silence_s)
    except BaseException as error:
        if must_stop_after(error):
            await drive.stop()
        raise


async def _result(drive: RemoteDrive) -> Json:
    """Return ``comm_loss`` of a drive when its test has ended."""
    from drivebus.service.api.operations.drives import DRIVES_GET

    while True:
        found: Json = (await drive.call(DRIVES_GET))["comm_loss"]
        if found["test"] is None:
            return found
        await asyncio.sleep(TEST_POLL_PERIOD_S)


def _print_result(name: str, found: Json, before: Json | None) -> ExitCode:
    """Print the result of a test, or why it has none: then the record is still the one from ``before``."""
    is_new = found["tested"] is not None and found["tested"]["time_ms"] != (before or {}).get("time_ms")
    tested = found["tested"] if is_new else None
    why = found["no_result"] and found["no_result"][output.language()]
    output.print_json({"event": "comm_loss_test", "drive": name, "tested": tested, "no_result": why}, stream=True)
    if tested is None:
        output.print_wrapped(why or output.text("comm_loss_test.nothing", drive=name))
        return ExitCode.FAILED
    key = f"comm_loss_test.{tested['result']}"
    output.print_message(key, drive=name, seconds=f"{tested['silence_s']:g}", fault=tested["fault"] or "-")
    return ExitCode.FAILED if tested["result"] == "runs_on" else ExitCode.DONE


command = CliCommand(
    "comm-loss-test",
    callback=_test,
    params=[
        options.required(options.service_option()),
        options.required(options.service_drive_option()),
        Option(["--frequency"], type=options.FREQUENCY, required=True, metavar="HZ"),
        Option(["--silence"], type=options.NumberType(2.0, 300.0), metavar="SECONDS", key="help.option.silence"),
        Option(["--yes"], is_flag=True, key="help.option.comm_loss_yes"),
    ],
    examples=(
        "drivebus comm-loss-test --service http://127.0.0.1:8080 --drive fan-1 --frequency 10",
        "drivebus comm-loss-test --service http://127.0.0.1:8080 --drive fan-1 --frequency 10 --silence 8 --yes",
    ),
)
