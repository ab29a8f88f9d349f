"""``capture export``: convert a capture to pcapng for Wireshark."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, CliCommand, LazyGroup, Option
from drivebus.cli.written_file import file_errors, write_file

if TYPE_CHECKING:
    from drivebus.capture.dbcap import Capture
    from drivebus.commissioning.decode.framing import CapturedFrame


def _export(*, file: str, pcapng: str, force: bool, all_modbus: bool) -> None:
    from drivebus.capture.dbcap import read_capture
    from drivebus.commissioning import wireshark
    from drivebus.commissioning.decode.framing import split_frames

    capture = read_capture(file)
    frames = split_frames(capture, all_modbus=all_modbus)
    comment = output.text("capture.export.comment", options=wireshark.WIRESHARK_OPTIONS, file=Path(file).name)
    with file_errors(pcapng):
        write_file(pcapng, wireshark.encode_wireshark(capture, frames, comment), replace=force)
    _print_result(file, pcapng, capture, frames)


def _print_result(file: str, out: str, capture: Capture, frames: list[CapturedFrame]) -> None:
    from drivebus.commissioning import wireshark

    command = f"wireshark {wireshark.WIRESHARK_OPTIONS} {quote(out)}"
    result: dict[str, Any] = {"file": file, "pcapng": out} | _counts(frames)
    dated = wireshark.capture_start_us(capture) is not None
    output.print_json(result | {"started": capture.header.started if dated else None, "truncated": capture.truncated})
    output.print_message("capture.export.done", **result)
    output.print_message("capture.export.open", command=command)
    if result["other"]:
        output.print_note("capture.export.other", count=result["other"])
    if capture.truncated:
        output.print_note("capture.export.truncated", file=file)
    if not dated:
        output.print_note("capture.export.undated", file=file)


def _counts(frames: list[CapturedFrame]) -> dict[str, int]:
    received, modbus = sum(frame.received for frame in frames), sum(frame.modbus for frame in frames)
    count = len(frames)
    return {"frames": count, "sent": count - received, "received": received, "modbus": modbus, "other": count - modbus}


def _pcapng(text: str) -> str:
    if not text.endswith(".pcapng"):
        raise ValueError(text)
    return text


export = CliCommand(
    "export",
    help_key="capture.export",
    callback=_export,
    params=[
        Argument(["file"], metavar="FILE", type=click.Path(), key="help.argument.capture"),
        Option(
            ["-o", "--output", "pcapng"],
            required=True,
            type=options.ParsedType("pcapng", _pcapng, "cli.expect.pcapng"),
            metavar="OUT",
            example="-o trip.pcapng",
            key="help.option.pcapng",
        ),
        Option(["--force"], is_flag=True),
        Option(["--all-modbus"], is_flag=True),
    ],
    examples=(
        "drivebus capture export trip-of-pump-3.dbcap -o trip.pcapng",
        "drivebus capture export trip-of-pump-3.dbcap -o trip.pcapng --force --json",
    ),
)

command = LazyGroup(
    "capture",
    help_key="capture",
    sections={"cli.section.commands": {"export": "drivebus.cli.commands.capture:export"}},
    no_args_is_help=True,
    examples=("drivebus capture export trip-of-pump-3.dbcap -o trip.pcapng",),
)
