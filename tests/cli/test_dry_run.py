"""``--dry-run`` prints the frames that the manuals print (with the commands left out where those are traps, T01)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from drivebus.cli.main import cli

VECTORS = {
    vector["id"]: vector
    for file in (Path(__file__).parents[2] / "vectors").glob("*.jsonl")
    for vector in map(json.loads, file.read_text(encoding="utf-8").splitlines())
}
NOWHERE = "/dev/there-is-no-such-port"
"""A dry run opens no port."""


def dry(*words: str) -> dict[str, Any]:
    """The document of a dry run."""
    verb, *rest = words
    result = CliRunner().invoke(cli, [verb, NOWHERE, *rest, "--dry-run", "--json"])
    assert result.exit_code == 0, result.output
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def frames(*words: str) -> list[str]:
    return [frame["hex"] for frame in dry(*words)["frames"]]


def canonical(vector_id: str) -> str:
    vector = VECTORS[vector_id]
    return str(vector.get("canonical_hex", vector["hex"]))


HEX = ("--encoding", "hex")
C320 = ("--model", "c320", "--address", "0")


@pytest.mark.parametrize(
    ("vector_id", "words"),
    [
        ("c320-4.3-request-ascii", ("read", "F0.1", *C320)),
        ("c320-4.3-request-hex", ("read", "F0.1", *C320, *HEX)),
        ("c320-sib-read-param-hex", ("read", "F0.16", *C320, *HEX)),
        ("c320-4.4-request-ascii", ("write", "F4.0=1", *C320)),
        ("c320-4.4-request-hex", ("write", "F4.0=1", *C320, *HEX)),
        ("c320-4.5-request-ascii", ("write", "F1.10=16", "--save", *C320)),
        ("c320-4.5-request-hex", ("write", "F1.10=16", "--save", *C320, *HEX)),
        ("c320-4.6-request-ascii", ("run", "--frequency", "9.99", *C320)),
        ("c320-4.6-request-hex", ("run", "--frequency", "9.99", *C320, *HEX)),
        ("c320-4.2-request-ascii", ("status", *C320)),
        ("c320-4.2-request-hex", ("status", *C320, *HEX)),
        ("dzb100-2-request", ("write", "10=15.0", "--save", "--model", "dzb100", "--address", "2")),
        ("dzb100-3-request", ("read", "23", "--model", "dzb100", "--address", "3")),
        (
            "dzb100-run-10hz",
            ("run", "--frequency", "10", "--option", "setpoint_coding=hex-0.1", "--model", "dzb100", "--address", "1"),
        ),
        ("dzb100-stop-all", ("stop", "--all", "--model", "dzb100", "--address", "1-3")),
        ("vc660-write-f00.02", ("write", "F00.02=30", "--model", "vc660", "--address", "1")),
        ("vc660-start", ("run", "--frequency", "10", "--model", "vc660", "--address", "1")),
        ("vc660-stop", ("stop", "--model", "vc660", "--address", "1")),
        ("df800-set-50hz-rtu", ("set-frequency", "50", "--model", "df800", "--address", "1")),
        ("df800-set-50hz-ascii", ("set-frequency", "50", "--model", "df800", "--address", "1", "--encoding", "ascii")),
        ("df800-start-rtu", ("run", "--frequency", "10", "--model", "df800", "--address", "1")),
        ("df800-start-ascii", ("run", "--frequency", "9", "--model", "df800", "--address", "1", "--encoding", "ascii")),
        ("df800-stop-rtu", ("stop", "--model", "df800", "--address", "1")),
        ("df800-stop-ascii", ("stop", "--model", "df800", "--address", "1", "--encoding", "ascii")),
        ("df800-reset-ascii", ("reset", "--model", "df800", "--address", "1", "--encoding", "ascii")),
        (
            "df800-f1.01-5-ascii",
            ("write", "F1.01=5", "--save", "--model", "df800", "--address", "1", "--encoding", "ascii"),
        ),
        ("df800-f1.07-20s-rtu", ("write", "F1.07=20", "--save", "--model", "df800", "--address", "1")),
    ],
)
def test_a_dry_run_prints_the_bytes_of_the_vector(vector_id: str, words: tuple[str, ...]) -> None:
    assert canonical(vector_id) in frames(*words)


def test_a_frame_is_told_with_its_reply_length_and_its_time_on_the_bus() -> None:
    """15 characters out and 18 back at 9600 8E1 (11 bits), 5 characters of silence before (manual 2.2.4)."""
    frame = dry("stop", *C320)["frames"][0]
    character_s = 11 / 9600
    assert frame["reply_bytes"] == 18
    assert frame["request_s"] == pytest.approx(15 * character_s, abs=1e-6)
    assert frame["reply_s"] == pytest.approx(18 * character_s, abs=1e-6)
    assert frame["bus_s"] == pytest.approx((5 + 15 + 18) * character_s, abs=2e-6)


def test_the_line_of_a_dry_run_is_the_options_else_the_links_else_the_profiles() -> None:
    assert dry("stop", *C320)["serial"] == "9600 8E1"
    assert dry("stop", *C320, "--baud", "19200", "--format", "8O1")["serial"] == "19200 8O1"
    link = f"serial://{NOWHERE}?baud=2400"
    result = CliRunner().invoke(cli, ["stop", link, *C320, "--dry-run", "--json"])
    assert json.loads(result.stdout)["serial"] == "2400 8E1"


def test_a_broadcast_is_told_to_have_no_reply() -> None:
    frame = dry("stop", "--all", "--model", "c320", "--address", "1-2")["frames"][0]
    assert frame["reply_bytes"] == 0


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800", "c300", "e300", "e500", "e550"])
@pytest.mark.parametrize("verb", ["status", "stop", "jog", "run", "scan", "monitor"])
def test_reads_in_a_dry_run_carry_no_command_and_every_verb_that_sends_has_one(verb: str, model: str) -> None:
    words = [verb, NOWHERE, "--dry-run", "--json"]
    if verb == "scan":
        words += ["--models", model]
    else:
        words += ["--model", model, "--address", "1"]
    words += ["--frequency", "5"] if verb == "run" else []
    words += ["--option", "setpoint_coding=hex-0.1"] if verb == "run" and model == "dzb100" else []
    result = CliRunner().invoke(cli, words)
    if result.exit_code != 0:
        assert json.loads(result.stdout)["error"]["type"] in ("CapabilityError", "StartInhibited", "LimitError")
        return
    document = json.loads(result.stdout)
    assert document["dry_run"] is True
    assert document.get("frames") or document.get("passes")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_dry_run_is_told_to_people_in_both_languages(language: str) -> None:
    words = ["run", NOWHERE, *C320, "--frequency", "9.99", "--dry-run", "--lang", language]
    result = CliRunner().invoke(cli, words)
    assert canonical("c320-4.6-request-ascii") in result.output
    assert "dry." not in result.output


SENDS_NOTHING = {"demo", "simulate", "decode", "models", "ports", "profile", "capture", "completion", "acceptance"}
"""The demo and the lab's campaigns speak to their own simulated plants only."""
OF_A_PLANT = {"init", "check", "serve", "user", "audit"}
"""What a plant would send is told by ``check`` before it is served; of a stop there is nothing to try. ``init`` reads
only, as ``scan`` does, whose dry run shows the frames."""


def test_every_verb_that_sends_has_a_dry_run() -> None:
    context = click.Context(cli)
    for name in set(cli.list_commands(context)) - SENDS_NOTHING - OF_A_PLANT:
        command = cli.get_command(context, name)
        assert command is not None
        assert "dry_run" in {param.name for param in command.params}, name


def test_a_value_that_fits_no_word_is_refused_in_a_dry_run_too() -> None:
    result = CliRunner().invoke(cli, ["write", NOWHERE, "F1.10=99999999", *C320, "--dry-run", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["error"]["type"] == "LimitError"


def test_a_frequency_that_goes_only_with_a_run_command_is_shown_as_a_running_drive_would_get_it() -> None:
    proved = ("--option", "query_coding=hex-0.1", "--option", "setpoint_coding=hex-0.1")
    found = dry("set-frequency", "10", "--model", "dzb100", "--address", "2", *proved)
    assert [frame["hex"] for frame in found["frames"]] == ["43 03 01 30 32 30 31 30 30 36 34"]
    assert "ran forward" in found["notes"][0]


@pytest.mark.parametrize(("save", "frames_before"), [((), 0), (("--save",), 1)])
def test_a_parameter_is_compared_only_before_it_is_saved(save: tuple[str, ...], frames_before: int) -> None:
    """The comparison spares the EEPROM; a write to RAM needs none."""
    found = dry("write", "F1.10=16", *C320, *save)["frames"]
    assert [frame["purpose"] for frame in found][frames_before] == "write a parameter"
