"""``--dry-run`` prints the worked frames of the manuals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli.main import cli

VECTORS = {
    vector["id"]: vector
    for file in (Path(__file__).parents[2] / "vectors").glob("*.jsonl")
    for vector in map(json.loads, file.read_text(encoding="utf-8").splitlines())
}
MISSING_PORT = "/dev/missing"  # a dry run opens no port


def dry(*words: str) -> dict[str, Any]:
    """Return the JSON document of a dry run."""
    command, *rest = words
    result = CliRunner().invoke(cli, [command, MISSING_PORT, *rest, "--dry-run", "--json"])
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
        ("c320-4.5-request-ascii", ("write", "F1.10=0010", "--save", *C320)),
        ("c320-4.5-request-hex", ("write", "F1.10=0010H", "--save", *C320, *HEX)),
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


def test_a_dry_run_of_a_loopback_says_that_its_numbers_begin_elsewhere_in_each_test() -> None:
    """The option promises the exact bytes, and a real port gets others each time."""
    assert "begin at a random one in each test" in dry("loopback", "--model", "vc660", "--address", "1")["notes"][0]


def test_a_dry_run_of_a_pause_and_of_a_ramp_hold_prints_their_levels() -> None:
    vc660 = ("--model", "vc660", "--address", "1")
    assert frames("pause", *vc660)[-1].startswith("01 06 20 00 00 80")
    assert [frame[:17] for frame in frames("hold-ramp", *vc660, "5")[2:4]] == ["01 06 20 00 01 00", "01 06 20 00 00 00"]


def test_a_dry_run_of_a_ramp_hold_shows_the_checks_before_it_and_the_stop_that_may_end_it() -> None:
    vc660 = ("--model", "vc660", "--address", "1")
    checked = frames("run", *vc660, "--frequency", "10")[:2]
    planned = frames("hold-ramp", *vc660, "5")
    assert sorted(planned[:2]) == sorted(checked)
    assert planned[4:] == frames("stop", *vc660)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("c320", ("jog",)),
        ("vc660", ("jog",)),
        ("c320", ("set-frequency", "10")),
        ("df800", ("set-frequency", "10")),
        ("dzb100", ("calibrate",)),
    ],
)
def test_a_dry_run_shows_the_checks_that_a_run_shows(model: str, words: tuple[str, ...]) -> None:
    """The plans of a jog, a set frequency and a calibration showed only their writes, as if nothing was read first."""
    options = ("--model", model, "--address", "1")
    planned = frames(*words, *options)
    run = dry("run", "--frequency", "0.5", *options)["frames"]
    checks = ("preflight", "ramp_times", "state")
    checked = [frame["hex"] for frame in run if frame["purpose"] in [i18n.text(f"dry.{name}", "en") for name in checks]]
    assert checked and planned[: len(checked)] == checked
    assert len(planned) > len(checked)


def test_a_dry_run_of_a_start_shows_the_reads_of_the_ramp_times() -> None:
    df800 = ("--model", "df800", "--address", "1", "--frequency", "10")
    purposes = [frame["purpose"] for frame in dry("run", *df800)["frames"]]
    assert purposes.count(i18n.text("dry.ramp_times", "en")) == 2


def test_a_planned_frame_has_its_reply_length_and_its_time_on_the_bus() -> None:
    """15 characters are sent and 18 received at 9600 8E1 (11 bits), after a gap of 5 characters (manual 2.2.4)."""
    frame = dry("stop", *C320)["frames"][0]
    character_s = 11 / 9600
    assert frame["reply_bytes"] == 18
    assert frame["request_s"] == pytest.approx(15 * character_s, abs=1e-6)
    assert frame["reply_s"] == pytest.approx(18 * character_s, abs=1e-6)
    assert frame["bus_s"] == pytest.approx((5 + 15 + 18) * character_s, abs=2e-6)


def test_serial_settings_come_from_the_options_then_the_port_url_then_the_profile() -> None:
    assert dry("stop", *C320)["serial"] == "9600 8E1"
    assert dry("stop", *C320, "--baud", "19200", "--format", "8O1")["serial"] == "19200 8O1"
    url = f"serial://{MISSING_PORT}?baud=2400"
    result = CliRunner().invoke(cli, ["stop", url, *C320, "--dry-run", "--json"])
    assert json.loads(result.stdout)["serial"] == "2400 8E1"


def test_a_planned_broadcast_has_no_reply() -> None:
    frame = dry("stop", "--all", "--model", "c320", "--address", "1-2")["frames"][0]
    assert frame["reply_bytes"] == 0


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800", "c300", "e300", "e350", "e500", "e550"])
@pytest.mark.parametrize("command", ["status", "stop", "jog", "run", "scan", "monitor"])
def test_every_command_has_a_dry_run_for_every_model_or_an_error_of_the_model(command: str, model: str) -> None:
    words = [command, MISSING_PORT, "--dry-run", "--json"]
    if command == "scan":
        words += ["--models", model]
    else:
        words += ["--model", model, "--address", "1"]
    words += ["--frequency", "5"] if command == "run" else []
    words += ["--option", "setpoint_coding=hex-0.1"] if command == "run" and model == "dzb100" else []
    result = CliRunner().invoke(cli, words)
    if result.exit_code != 0:
        assert json.loads(result.stdout)["error"]["type"] in ("CapabilityError", "StartInhibited", "LimitError")
        return
    document = json.loads(result.stdout)
    assert document["dry_run"] is True
    assert document.get("frames") or document.get("passes")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_text_of_a_dry_run_is_in_the_users_language(language: str) -> None:
    words = ["run", MISSING_PORT, *C320, "--frequency", "9.99", "--dry-run", "--lang", language]
    result = CliRunner().invoke(cli, words)
    assert canonical("c320-4.6-request-ascii") in result.output
    assert "dry." not in result.output


SENDS_NOTHING = {
    "demo",
    "simulate",
    "decode",
    "models",
    "ports",
    "profile",
    "capture",
    "completion",
    "acceptance",
    "comm-loss-test",
    "control",
    "release",
    "waive",
}
"""Commands that send nothing, or only to simulated drives of their own, or have steps of their own."""
PLANT_COMMANDS = {"init", "check", "serve", "user", "audit"}
"""Commands on a plant: ``check`` shows its load on the buses; ``init`` only reads, as ``scan`` does."""


def test_every_command_that_sends_has_a_dry_run() -> None:
    context = click.Context(cli)
    for name in set(cli.list_commands(context)) - SENDS_NOTHING - PLANT_COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        assert "dry_run" in {param.name for param in command.params}, name


def test_a_value_out_of_range_is_an_error_of_a_dry_run() -> None:
    result = CliRunner().invoke(cli, ["write", MISSING_PORT, "F1.10=99999999", *C320, "--dry-run", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["error"]["type"] == "LimitError"


def test_a_frequency_that_needs_a_run_command_is_planned_for_a_running_drive() -> None:
    calibrated = ("--option", "query_coding=hex-0.1", "--option", "setpoint_coding=hex-0.1")
    found = dry("set-frequency", "10", "--model", "dzb100", "--address", "2", *calibrated)
    assert found["frames"][-1]["hex"] == "43 03 01 30 32 30 31 30 30 36 34"
    assert "ran forward" in found["notes"][0]


@pytest.mark.parametrize(("save", "frames_before"), [((), 0), (("--save",), 1)])
def test_a_parameter_is_compared_before_it_is_saved_and_not_before_a_ram_write(
    save: tuple[str, ...], frames_before: int
) -> None:
    """The comparison saves EEPROM writes; a write to RAM needs none."""
    found = dry("write", "F1.10=16", *C320, *save)["frames"]
    assert [frame["purpose"] for frame in found][frames_before] == "write a parameter"


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ("0106200113 88DE9C", ("set-frequency", "50", "--model", "eds300")),  # EDS300 manual 7.7.3
        ("010620000006 0208", ("stop", "--model", "eds300")),  # EDS300 manual 7.7.2
        ("010321000001 8E36", ("status", "--model", "eds300")),  # EDS300 manual 7.7.4
        ("010321000001 8E36", ("status", "--model", "gd350")),  # Goodrive300-LIFT manual 10.4.8.1
        ("0106100201F4 2CDD", ("set-frequency", "50", "--model", "e300_modbus")),  # E300 manual page 66
        ("010620000006 0208", ("stop", "--model", "eds800")),  # EDS800 manual 10.7.2
        ("0106200113 88DE9C", ("set-frequency", "50", "--model", "eds800")),  # EDS800 manual 10.7.3
        ("010321000001 8E36", ("status", "--model", "eds800")),  # EDS800 manual 10.7.4
        ("010680000000 A00A", ("stop", "--model", "e5_h")),  # V&T E5-H manual page 122
        ("010381360001 4C38", ("status", "--model", "e5_h")),  # V&T E5-H manual page 122
        ("010625010001 12C6", ("run", "--frequency", "5", "--model", "teco_f510")),  # Teco F510 manual page 7-4
        ("010625010003 9307", ("run", "--frequency", "5", "--reverse", "--model", "teco_f510")),  # the same page
        ("010625010000 D306", ("stop", "--model", "teco_f510")),  # the same page
        ("010600000001 480A", ("run", "--frequency", "5", "--model", "dc1")),  # Eaton DC1 manual page 148
        ("010600000001 480A", ("run", "--frequency", "5", "--model", "de1")),  # Eaton DE1 manual page 127
    ],
)
def test_models_with_numbers_for_commands_send_the_frames_of_their_makers_manuals(
    frame: str, words: tuple[str, ...]
) -> None:
    assert frame.replace(" ", "") in [planned.replace(" ", "") for planned in frames(*words, "--address", "1")]


def test_the_plan_of_a_share_reads_the_maximum_frequency_and_says_which_one_it_assumes() -> None:
    document = dry("run", "--frequency", "20", "--model", "skf8000", "--address", "3")
    sent = [frame["hex"].replace(" ", "") for frame in document["frames"]]
    assert any(frame.startswith("0303F00A0001") for frame in sent)  # P0-10
    assert any(frame.startswith("030610000FA0") for frame in sent)  # 4000 of 10000
    notes = " ".join(document["notes"])
    assert "P0-10, shown for 50 Hz" in notes and "a frequency above it is refused" in notes


@pytest.mark.parametrize("command", ["stop", "coast"])
def test_the_plan_of_a_first_stop_begins_with_the_read_that_shows_the_model(command: str) -> None:
    sent = [frame["hex"].replace(" ", "") for frame in dry(command, "--model", "gd10", "--address", "3")["frames"]]
    assert len(sent) == 2 and sent[0].startswith("030321000001") and sent[1].startswith("03062000")


def test_the_plan_of_a_stop_with_an_assumed_model_has_no_read() -> None:
    document = dry("stop", "--model", "gd10", "--address", "3", "--assume-model")
    assert [frame["hex"].replace(" ", "")[:12] for frame in document["frames"]] == ["030620000005"]


def test_the_plan_of_a_run_shows_the_words_before_the_start() -> None:
    document = dry("run", "--frequency", "5", "--model", "acs550", "--address", "3")
    sent = [frame["hex"].replace(" ", "")[:12] for frame in document["frames"]]
    first, second, start = (sent.index(f"03060000{word}") for word in ("0476", "0477", "047F"))
    assert first < second < start and sent.count("030600000476") == 1
    assert any("only in the status that asks for it" in note for note in document["notes"])


def test_the_writes_of_a_reset_on_an_edge_begin_with_the_stop_word() -> None:
    sent = [
        frame["hex"].replace(" ", "")[:12] for frame in dry("reset", "--model", "acs550", "--address", "3")["frames"]
    ]
    assert [frame for frame in sent if frame.startswith("0306")] == ["03060000047E", "0306000004FE"]


@pytest.mark.parametrize(("model", "shows_state"), [("c320", True), ("vc660", True), ("df800", False)])
def test_the_plan_of_a_reset_shows_the_state_that_decides_on_it(model: str, shows_state: bool) -> None:
    """Without a fault a reset writes nothing."""
    document = dry("reset", "--model", model, "--address", "3")
    purposes = [frame["purpose"] for frame in document["frames"]]
    assert (purposes[0] == i18n.text("dry.state", "en")) is shows_state
    assert any("shows a fault" in note for note in document["notes"]) is shows_state


def test_the_plan_of_a_run_shows_the_unlock_and_the_direction_before_the_start() -> None:
    document = dry("run", "--frequency", "5", "--model", "smd", "--address", "3")
    sent = [frame["hex"].replace(" ", "")[:12] for frame in document["frames"] if frame["hex"].startswith("03 06")]
    assert sent == ["030600300000", "030600010080", "030600280032", "030600010008"]


def test_the_plan_of_a_stop_names_the_unlock_of_a_drive_that_rejects_it() -> None:
    for model, named in (("smd", True), ("gd10", False)):
        document = dry("stop", "--model", model, "--address", "3")
        assert any("is unlocked, and the stop is sent again" in note for note in document["notes"]) is named
        assert not any(frame["hex"].startswith("03 06 00 30") for frame in document["frames"])


REFUSED_COMMAND_LINES = [
    "run sim://c320@1 --model c320 --address 1 --frequency 80",
    "run sim://c320@1 --model c320 --address 1 --frequency 80 --reverse",
    "set-frequency sim://vc660@1 80 --model vc660 --address 1",
    "run sim://dzb100@1 --model dzb100 --address 1 --frequency 20",
    "run sim://vc660@1 --model t13 --address 1 --frequency 20",
    "run sim://c320@1 --model c320 --address 1 --frequency 20 --option setpoint_step=unknown",
]
"""Command lines that the command refuses before it asks the drive."""


@pytest.mark.parametrize("line", REFUSED_COMMAND_LINES)
def test_a_dry_run_refuses_what_the_command_refuses_before_it_asks_the_drive(line: str) -> None:
    """A start frame of 80 Hz was shown for a drive of at most 50 Hz."""
    real, planned = (CliRunner().invoke(cli, [*line.split(), *more]) for more in ([], ["--dry-run"]))
    assert (planned.exit_code, planned.output) == (real.exit_code, real.output)
    assert (real.exit_code, planned.stdout) == (1, "")


def test_a_dry_run_of_a_jog_refuses_a_frequency_above_the_maximum() -> None:
    result = CliRunner().invoke(cli, ["jog", MISSING_PORT, *C320, "--frequency", "80", "--dry-run"])
    assert (result.exit_code, "80.0 Hz is above the maximum of 50.0 Hz" in result.output) == (1, True), result.output


def test_a_dry_run_of_a_stated_share_refuses_what_the_command_refuses_before_it_asks_the_drive() -> None:
    """The plan took the stated maximum for one that the command reads."""
    words = ["--model", "g120c", "--address", "1", "--frequency", "20"]
    real, planned = (CliRunner().invoke(cli, ["run", "sim://c320@1", *words, *more]) for more in ([], ["--dry-run"]))
    assert (real.exit_code, planned.exit_code, planned.output) == (1, 1, real.output)


@pytest.mark.parametrize(
    "line",
    [
        "run {port} --model dzb100 --address 1 --frequency 20",
        "run {port} --model df800 --address 1 --frequency 20 --reverse",
        "jog {port} --model df800 --address 1",
    ],
)
def test_a_refusal_of_a_dry_run_that_a_stored_calibration_may_lift_says_that_none_was_read(line: str) -> None:
    """A calibrated drive was called uncalibrated without a word: its record is found through an open port only."""
    note = i18n.text("dry.note.calibration", "en")
    words = [*line.format(port=MISSING_PORT).split(), "--dry-run"]
    at_a_port = CliRunner().invoke(cli, words, env={"COLUMNS": "300"})
    simulated = CliRunner().invoke(cli, [words[0], f"sim://{words[3]}@1", *words[2:]])
    assert (at_a_port.exit_code, note in at_a_port.stderr) == (1, True), at_a_port.output
    assert note not in simulated.output


def test_a_refusal_of_a_dry_run_that_no_calibration_lifts_has_no_word_about_one() -> None:
    words = ["run", MISSING_PORT, *C320, "--frequency", "80", "--dry-run"]
    assert i18n.text("dry.note.calibration", "en") not in CliRunner().invoke(cli, words).output
