"""``--record`` writes every sent and received byte of a command to a capture."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivebus.capture.dbcap import BytesRecord, EventRecord, read_capture
from drivebus.cli.main import cli

C320 = ("--model", "c320", "--address", "1")


pytestmark = pytest.mark.usefixtures("clean_simulated_buses", "commands_in_virtual_time")


def invoke(*words: str) -> Result:
    return CliRunner().invoke(cli, [*words, "--lang", "en"])


def sent(file: Path) -> list[str]:
    records = [record for record in read_capture(file).records if isinstance(record, BytesRecord)]
    return [record.data.hex(" ").upper() for record in records if record.direction == "tx"]


@pytest.mark.parametrize("command", [("stop",), ("read", "F0.1"), ("write", "F1.10=1"), ("reset",)])
def test_a_capture_has_every_frame_of_the_command(tmp_path: Path, command: tuple[str, ...]) -> None:
    file = tmp_path / "one.dbcap"
    result = invoke(command[0], "sim://c320@1", *command[1:], *C320, "--record", str(file))
    assert result.exit_code == 0, result.output
    received = [
        record for record in read_capture(file).records if isinstance(record, BytesRecord) and record.direction == "rx"
    ]
    assert sent(file) and received
    assert f"drivebus monitor {file}" in result.stderr


def test_the_first_frame_recorded_is_the_first_frame_of_the_dry_run(tmp_path: Path) -> None:
    file = tmp_path / "one.dbcap"
    dry = json.loads(invoke("stop", "sim://c320@1", *C320, "--dry-run", "--json").stdout)
    assert invoke("stop", "sim://c320@1", *C320, "--record", str(file)).exit_code == 0
    assert sent(file)[0] == dry["frames"][0]["hex"]


def test_monitor_shows_a_recorded_bus(tmp_path: Path) -> None:
    file = tmp_path / "line.dbcap"
    live = ("monitor", "sim://vc660@1", "--model", "vc660", "--address", "1", "--plain", "--period", "1")
    assert invoke(*live, "--duration", "1.5", "--record", str(file)).exit_code == 0
    shown = invoke("monitor", str(file), "--json", "--speed", "50")
    assert shown.exit_code == 0
    drives = json.loads(shown.stdout.splitlines()[-1])["drives"]
    assert [(drive["model"], drive["address"], drive["state"]) for drive in drives] == [("vc660", 1, "stopped")]


def test_the_capture_of_a_scan_has_the_serial_settings_of_each_pass(tmp_path: Path) -> None:
    file = tmp_path / "scan.dbcap"
    words = ("scan", "sim://vc660@1?drives=19200-8N1", "--models", "vc660", "--addresses", "1-2", "--formats", "8N1")
    result = invoke(*words, "--bauds", "9600,19200", "--listen-seconds", "0.1", "--record", str(file), "--json")
    assert result.exit_code == 0, result.output
    opened = [
        record for record in read_capture(file).records if isinstance(record, EventRecord) and record.name == "opened"
    ]
    assert [event.details["baud"] for event in opened] == [9600, 9600, 19200], "listened first, then both settings"
    assert json.loads(result.stdout)["found"][0]["sent"] in sent(file)
    assert f"drivebus monitor {file}" in result.stderr


def test_a_capture_that_exists_is_never_overwritten_and_nothing_is_sent(tmp_path: Path) -> None:
    file = tmp_path / "evidence.dbcap"
    file.write_text("evidence")
    result = invoke("reset", "sim://c320@1", *C320, "--record", str(file))
    assert result.exit_code == 2
    assert file.read_text() == "evidence"
    assert "exists" in result.stderr


@pytest.mark.parametrize("name", ["evidence.dbcap", "no-folder/new.dbcap", "trip.txt"])
@pytest.mark.parametrize(
    "words",
    [
        ("stop", "sim://c320@1", *C320),
        ("stop", "--all", "sim://c320@1", *C320),
        ("coast", "sim://vc660@1", "--model", "vc660", "--address", "1"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_capture_that_can_not_be_written_prevents_no_stop(tmp_path: Path, words: tuple[str, ...], name: str) -> None:
    """A file of the same name, and a name that does not end with ``.dbcap``, left the motor running."""
    (tmp_path / "evidence.dbcap").write_text("evidence")
    result = invoke(*words, "--record", str(tmp_path / name))
    assert (result.exit_code, "onfirmed" in result.stdout) == (0, True), result.output
    assert result.stderr.startswith("Not recorded: ") and name in result.stderr
    assert (tmp_path / "evidence.dbcap").read_text() == "evidence"
    assert [path.name for path in tmp_path.iterdir()] == ["evidence.dbcap"]


@pytest.mark.parametrize(
    "words", [("reset", "sim://c320@1", *C320, "--record", "x.txt"), ("monitor", "old.dbcap", "--record", "new.dbcap")]
)
def test_an_invalid_record_option_is_a_usage_error(words: tuple[str, ...]) -> None:
    result = invoke(*words)
    assert result.exit_code == 2
    assert "record" in result.stderr
