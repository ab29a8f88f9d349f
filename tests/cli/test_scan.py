"""A scan that ends early: its JSON stays one document, and what it found is not lost."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n, profiles
from drivebus.cli import output
from drivebus.cli.errors import ExitCode, error_hint
from drivebus.cli.main import cli
from drivebus.cli.scan_output import ScanProgressBar, announce_scan, print_scan
from drivebus.cli.scanning import ScanRequest
from drivebus.commissioning import scan
from drivebus.errors import PortLost
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.port import clear_simulated_buses
from drivebus.user_input import parse_addresses

pytestmark = pytest.mark.usefixtures("commands_in_virtual_time")

WORDS = ("scan", "sim://vc660@3", "--models", "vc660", "--addresses", "3", "--listen-seconds", "0", "--lang", "en")


@pytest.fixture(autouse=True)
def adapter_that_is_pulled(monkeypatch: pytest.MonkeyPatch) -> None:
    clear_simulated_buses()
    find = scan.scan

    async def find_and_lose_the_port(*given: Any, **options: Any) -> None:
        await find(*given, **options)
        raise PortLost("ports.lost", port="/dev/ttyUSB0", reason="Input/output error")

    monkeypatch.setattr(scan, "scan", find_and_lose_the_port)


def test_the_json_of_a_scan_whose_port_is_lost_is_one_document_with_what_was_found() -> None:
    """It was followed by the document of the error."""
    found = CliRunner().invoke(cli, [*WORDS, "--json"])
    document = json.loads(found.stdout)
    assert [drive["address"] for drive in document["found"]] == [3]
    assert (document["error"]["key"], document["exit"], found.exit_code) == ("ports.lost", 1, 1)
    assert "Check the adapter's plug and supply" in document["error"]["hint"], "the loss alone is no next step"


def test_a_scan_whose_port_is_lost_prints_what_was_found_and_the_error() -> None:
    found = CliRunner().invoke(cli, WORDS)
    assert "vc660" in found.stdout and "/dev/ttyUSB0" in found.stderr and found.exit_code == 1


@pytest.mark.parametrize(("models", "exit_code"), [((), 1), (("vc660",), 0)])
def test_a_scan_succeeds_only_with_a_drive_whose_model_is_known(
    models: tuple[str, ...], exit_code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device that rejects the reads of every model ended it with 0, and a script had no model to command."""

    async def find(passes: Any, open_port: Any, progress: scan.ScanProgress, *rest: Any, **options: Any) -> None:
        drive = scan.DetectedDrive(
            models=models, setpoint_steps_hz={}, family="modbus", encoding="rtu", address=3,
            settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
        )  # fmt: skip
        progress.found.append(drive)

    monkeypatch.setattr(scan, "scan", find)
    assert CliRunner().invoke(cli, WORDS).exit_code == exit_code


@pytest.mark.parametrize(
    ("addresses", "bauds", "likely"),
    [
        ("5-20", None, "(9600, 19200, 4800, 38400 baud, addresses 5-8)"),
        ("5-20", (4800, 1200), "(4800 baud, addresses 5-8)"),
        ("1-8", (9600,), None),
        ("100", (9600,), None),
    ],
)
def test_a_scan_announces_as_likely_only_what_it_searches(
    addresses: str, bauds: tuple[int, ...] | None, likely: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Addresses 0-8 at four baud rates were announced, whatever was asked for."""
    request = ScanRequest(
        port="sim://vc660@5", models=("vc660",), addresses=parse_addresses(addresses), bauds=bauds, formats=None
    )
    announce_scan(request.plan())
    shown = " ".join(capsys.readouterr().err.split())
    assert ("The scan takes at most" in shown, "come first" in shown) == (likely is None, likely is not None)
    assert likely is None or f"The likely settings {likely} come first" in shown


def test_the_advice_after_a_scan_without_a_drive_fits_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was one line of 200 characters, which the terminal broke within its words."""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("drivebus.cli.output.terminal_width", lambda _: 40)
    print_scan("sim://vc660@3", scan.ScanProgress(total_s=1.0, done_s=1.0), None, ExitCode.FAILED)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("No drive answered.") and max(map(len, lines)) <= 40, lines


def test_the_end_of_a_replayed_capture_is_not_answered_with_the_plug_of_an_adapter() -> None:
    lost = PortLost("ports.lost", port="replay:///trip.dbcap", reason=PortLost("ports.capture_end"))
    assert error_hint(lost) == i18n.text("hint.ports.capture_end", output.language())


@pytest.mark.parametrize("command", ["scan", "monitor"])
def test_a_port_that_can_not_be_opened_is_not_listened_on(command: str) -> None:
    """``Listening for 2 s before sending …`` stood above the error of a port that does not exist."""
    lang = ("--lang", "en")
    failed = CliRunner().invoke(cli, [command, "/dev/ttyDRIVEBUS99", *lang])
    assert failed.exit_code == 1 and "does not exist" in failed.stderr and "Listening" not in failed.stderr
    words = ("scan", "sim://vc660@3", "--models", "vc660", "--addresses", "3", "--listen-seconds", "0.01")
    assert "Listening for 0.01 s" in CliRunner().invoke(cli, [*words, *lang]).stderr


def test_a_drive_of_many_models_is_reported_during_the_scan_without_a_broken_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The names were joined by ``/`` alone, and the terminal broke ``optidrive_p2`` at its edge."""
    shown: list[str] = []
    monkeypatch.setattr(ScanProgressBar, "print_above", lambda bar, line: shown.append(line))
    models = tuple(profiles.models()[:30])
    drive = scan.DetectedDrive(
        models=models, setpoint_steps_hz={}, family="modbus", encoding="rtu", address=3,
        settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip
    ScanProgressBar().on_progress(scan.ScanProgress(total_s=1.0, found=[drive]))
    lines = output.wrap(shown[0], 79)
    assert max(map(output.width, lines)) <= 79 and set(models) <= set(" ".join(lines).split())
