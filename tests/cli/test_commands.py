"""Commands that end by themselves, on simulated drives: JSON documents, texts and exit codes."""

from __future__ import annotations

import json
import os
import signal
import socketserver
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import errors, i18n, profiles
from drivebus.cli import errors as cli_errors
from drivebus.cli.main import cli
from drivebus.drives import Drive
from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.ports import discovery
from fixtures.usb_serial import install_latency_timers

C320 = ("--model", "c320", "--address", "1")


pytestmark = pytest.mark.usefixtures("clean_simulated_buses", "commands_in_virtual_time")


def run_json(*words: str, code: int = 0) -> dict[str, Any]:
    """Run a command that must exit with ``code``; return its JSON document."""
    result = CliRunner().invoke(cli, [*words, "--json"])
    assert result.exit_code == code, result.output
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def run_text(*words: str, code: int = 0) -> str:
    result = CliRunner().invoke(cli, list(words), env={"COLUMNS": "200"})
    assert result.exit_code == code, result.output
    return result.output


STATES_AT_STANDSTILL = [("c320", "stopped"), ("dzb100", "stopped"), ("vc660", "stopped"), ("df800", "unknown")]


@pytest.mark.parametrize(("model", "state"), STATES_AT_STANDSTILL)
def test_status_has_state_fault_and_readings_with_unit_quality_and_age(model: str, state: str) -> None:
    """The manual of the DF800 defines no run status: its state is unknown, never stopped."""
    found = run_json("status", f"sim://{model}@1", "--model", model, "--address", "1")
    assert found["state"] == state
    assert found["fault"] is None
    assert (found["reason"] is None) == (state != "unknown")
    for name in ("set_frequency", "output_frequency", "output_current", "output_voltage", "dc_bus_voltage"):
        reading = found["readings"][name]
        assert set(reading) >= {"value", "unit", "quality", "age_s"}
        assert reading["value"] is not None or reading["reason"]


@pytest.mark.parametrize(
    ("model", "settings", "is_named"),
    [
        ("c320", ("--baud", "38400"), True),
        ("dzb100", ("--baud", "9600"), True),
        ("dzb100", ("--format", "8N1"), True),
        ("c320", ("--baud", "19200", "--format", "8O1"), False),
    ],
)
@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_serial_settings_outside_the_manual_are_named(
    model: str, settings: tuple[str, ...], is_named: bool, dry: tuple[str, ...]
) -> None:
    words = ("status", f"sim://{model}@1?drives=19200-8O1", "--model", model, "--address", "1", *settings, *dry)
    result = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert (f"the manual of {model} does not have" in result.stderr) is is_named


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_text_of_status_has_no_catalogue_key(language: str) -> None:
    text = run_text("status", "sim://c320@1", *C320, "--lang", language)
    assert "drives." not in text and "status." not in text
    assert ("停止" if language == "zh" else "stopped") in text


def test_read_shows_notation_wire_address_raw_and_scaled_value() -> None:
    values = run_json("read", "sim://c320@1", "F0.1", "F1.10", "output_frequency", *C320)["values"]
    by_name = {value["name"]: value for value in values}
    assert by_name["F0.1"]["raw"] == 2
    assert by_name["F0.1"]["wire"] == {"space": "parameter", "address": 1, "hex": "0001H"}
    assert by_name["F1.10"]["wire"]["hex"] == "010AH"
    assert by_name["output_frequency"]["unit"] == "Hz"


def test_read_shows_the_factory_setting_beside_the_value() -> None:
    """It was on the page and in the API only."""
    drive = ("sim://vc660@1", "F00.01", "output_frequency", "--model", "vc660", "--address", "1")
    found = run_json("read", *drive)["values"]
    assert [value["factory"] for value in found] == [2.0, None]
    assert "source of the frequency = serial port (factory setting 2)" in run_text("read", *drive)
    assert "（出厂值 2）" in run_text("read", *drive, "--lang", "zh")


def test_an_unknown_name_does_not_keep_the_other_names_from_being_read() -> None:
    """A single mistyped name of ten left the user without any value, and named itself only."""
    words = ("read", "sim://c320@1", "F0.300", "F0.1", "output_frequence", "output_frequency", *C320)
    found = run_json(*words, code=2)
    assert [value["name"] for value in found["values"]] == ["F0.1", "output_frequency"]
    assert found["values"][0]["raw"] == 2
    assert [refusal["params"]["name"] for refusal in found["refused"]] == ["F0.300", "output_frequence"]
    text = run_text(*words, code=2)
    assert "frequency channel" in text
    assert "c320 has no F0.300" in text and "near: output_frequency" in text
    planned = run_text(*words, "--dry-run", code=2)
    assert "read a parameter" in planned and "c320 has no F0.300" in planned


def test_of_unknown_names_alone_each_is_named_and_no_port_is_opened() -> None:
    text = run_text("read", "/dev/none", "F0.300", "F1.999", *C320, code=2)
    assert "c320 has no F0.300" in text and "c320 has no F1.999" in text


@pytest.mark.parametrize("names", [("F0.300", "F1.999"), ("F0.300", "F0.1", "F1.999")])
@pytest.mark.parametrize("dry_run", [(), ("--dry-run",)])
def test_the_json_has_each_unknown_name_also_where_none_is_known(
    names: tuple[str, ...], dry_run: tuple[str, ...]
) -> None:
    """Without a known name the document had the last name only; with ``--dry-run`` it had no name."""
    found = run_json("read", "sim://c320@1", *names, *C320, *dry_run, code=2)
    assert [refusal["params"]["name"] for refusal in found["refused"]] == ["F0.300", "F1.999"]
    assert len(found["frames" if dry_run else "values"]) == len(names) - 2


def test_a_write_is_confirmed_by_a_read_and_stays_in_the_drive() -> None:
    url = "sim://c320@1?name=written"
    assert run_json("write", url, "F1.10=1", *C320)["outcome"] == "confirmed"
    assert run_json("read", url, "F1.10", *C320)["values"][0]["raw"] == 1


def test_a_model_without_a_separate_ram_write_requires_save() -> None:
    words = ("write", "sim://df800@1", "F1.07=12", "--model", "df800", "--address", "1")
    error = run_json(*words, code=1)["error"]
    assert error["type"] == "CapabilityError"
    assert "--save" in error["hint"]
    assert run_json(*words, "--save")["outcome"] == "confirmed"


def test_a_new_address_is_written_only_with_force_and_the_broadcast_address_never() -> None:
    words = ("write", "sim://dzb100@1", "--save", "--model", "dzb100", "--address", "1")
    error = run_json(*words, "78=2", code=1)["error"]
    assert (error["type"], error["params"]["present"]) == ("ConfirmationRequired", 1)
    assert "--force" in error["hint"] and "78 = 1 at station 2" in error["text"]
    assert run_json(*words, "78=2", "--dry-run", code=1)["error"]["type"] == "ConfirmationRequired"
    assert run_json(*words, "78=2", "--force")["outcome"] == "confirmed"
    assert run_json(*words, "78=0", "--force", code=1)["error"]["key"] == "drives.write_broadcast"


def test_the_eeprom_budget_is_set_by_the_user_and_outlives_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The count is stored as for a serial port; that of a simulated drive would end with the program."""
    monkeypatch.setattr("drivebus.drives.drive.VOLATILE_SCHEMES", ())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    words = ("write", "sim://df800@1", "--save", "--model", "df800", "--address", "1")
    assert run_json(*words, "F1.07=12", "--eeprom-writes-per-day", "1")["outcome"] == "confirmed"
    error = run_json(*words, "F1.07=13", "--eeprom-writes-per-day", "1", code=1)["error"]
    assert (error["type"], error["params"]["budget"]) == ("EepromBudgetExceeded", 1)
    assert "--eeprom-writes-per-day" in error["hint"]
    assert run_json(*words, "F1.07=13")["outcome"] == "confirmed", "20 without the option"


def test_an_eeprom_budget_that_is_no_whole_number_is_an_error_with_the_expected_value() -> None:
    words = ("write", "sim://df800@1", "F1.07=12", "--save", "--model", "df800", "--address", "1")
    text = run_json(*words, "--eeprom-writes-per-day", "-1", code=2)["error"]["text"]
    assert "--eeprom-writes-per-day" in text and "found -1" in text and "expected a whole number" in text


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_error_of_an_offline_drive_names_the_next_step(language: str) -> None:
    text = run_text("status", "sim://c320@1", "--model", "c320", "--address", "2", "--lang", language, code=1)
    assert "drivebus scan PORT" in text


def test_a_stop_that_is_the_first_frame_on_a_bus_of_df800_is_acknowledged() -> None:
    """The reply equals the request: a read before it shows that the adapter does not echo."""
    assert run_json("stop", "sim://df800@1", "--model", "df800", "--address", "1")["outcome"] == "acknowledged"


def test_stop_confirms_and_set_frequency_starts_nothing() -> None:
    url = "sim://vc660@1?name=still"
    drive = ("--model", "vc660", "--address", "1")
    assert run_json("set-frequency", url, "25", *drive)["outcome"] == "confirmed"
    assert run_json("status", url, *drive)["state"] == "stopped"
    assert run_json("stop", url, *drive)["outcome"] == "confirmed"


def test_a_frequency_above_the_maximum_is_refused_before_anything_is_sent() -> None:
    found = run_json("set-frequency", "sim://c320@1", "3999", *C320, code=1)
    assert found["error"]["type"] == "LimitError"


def test_a_command_that_the_model_does_not_have_exits_with_1() -> None:
    found = run_json("coast", "sim://df800@1", "--model", "df800", "--address", "1", code=1)
    assert found["error"]["type"] == "CapabilityError"


def test_loopback_counts_what_the_drive_returns() -> None:
    drive = ("sim://vc660@3", "--model", "vc660", "--address", "3", "--count", "4")
    found = run_json("loopback", *drive)
    assert (found["requests"], found["returned"], found["repetitions"], found["error"]) == (4, 4, 0, None)
    assert 0 < found["round_trip_ms"]["min"] <= found["round_trip_ms"]["mean"] <= found["round_trip_ms"]["max"]
    shown = " ".join(run_text("loopback", *drive, "--lang", "en").split())
    assert shown.startswith(i18n.text("loopback.returned", returned=4, requests=4))


def test_a_loopback_without_a_reply_has_no_times(monkeypatch: pytest.MonkeyPatch) -> None:
    async def loopback_test(drive: Drive, count: int, is_cancelled: Callable[[], bool]) -> LoopbackReport:
        return LoopbackReport(count, (), 0, errors.NoReply("bus.no_reply", station=3, milliseconds=56))

    monkeypatch.setattr(Drive, "loopback_test", loopback_test)
    words = ("sim://vc660@3", "--model", "vc660", "--address", "3", "--count", "4", "--lang", "en")
    text = run_text("loopback", *words, code=1)
    assert text.startswith(i18n.text("loopback.returned", returned=0, requests=4)) and "Round trip" not in text


@pytest.mark.parametrize(
    ("repetitions", "error"), [(0, None), (2, None), (1, errors.NoReply("bus.no_reply", station=3, milliseconds=56))]
)
def test_loopback_names_its_repetitions_and_its_last_error_only_where_there_were_some(
    monkeypatch: pytest.MonkeyPatch, repetitions: int, error: errors.DrivebusError | None
) -> None:
    async def loopback_test(drive: Drive, count: int, is_cancelled: Callable[[], bool]) -> LoopbackReport:
        return LoopbackReport(count, (0.02,) * (count - (error is not None)), repetitions, error)

    monkeypatch.setattr(Drive, "loopback_test", loopback_test)
    words = ("sim://vc660@3", "--model", "vc660", "--address", "3", "--count", "4", "--lang", "en")
    text = run_text("loopback", *words, code=int(error is not None))
    repeated = f"Repeated because a reply was missing or damaged: {repetitions}."
    assert (repeated in text, "Repeated" in text) == (repetitions > 0, repetitions > 0)
    returned = 4 - (error is not None)
    times = {"low": 20.0, "mean": 20.0, "high": 20.0}
    assert i18n.text("loopback.returned", returned=returned, requests=4) in text
    assert i18n.text("loopback.times", **times) in text
    assert ("Last error: station 3: no reply within 56 ms" in text, "rror" in text) == (error is not None,) * 2


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupted_loopback_prints_the_counts_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: Ctrl-C ended the test without its counts."""
    whole_test, sent = Drive.loopback_test, iter(range(4))

    async def interrupted_test(drive: Drive, count: int, is_cancelled: Callable[[], bool]) -> LoopbackReport:
        def check_and_interrupt() -> bool:
            ends = is_cancelled()
            if next(sent, None) == 2:
                os.kill(os.getpid(), signal.SIGINT)  # arrives while the third request is answered
            return ends

        return await whole_test(drive, count, check_and_interrupt)

    monkeypatch.setattr(Drive, "loopback_test", interrupted_test)
    drive = ("sim://vc660@3", "--model", "vc660", "--address", "3", "--count", "10000")
    found = run_json("loopback", *drive, code=130)
    assert (found["requests"], found["returned"], found["complete"]) == (3, 3, False)


def test_status_shows_what_a_c320_reports_about_itself() -> None:
    drive = ("sim://c320@1", "--model", "c320", "--address", "1")
    identity = run_json("status", *drive)["identity"]
    assert (identity["voltage_class_v"], identity["power_kw"], identity["host_controls"]) == (380, 2.2, True)
    assert set(identity["digits"]) == {"model", "series", "version", "control"}
    text = CliRunner().invoke(cli, ["status", *drive, "--lang", "en"]).stdout
    assert "380 V, 2.2 kW" in text and "run command from the bus" in " ".join(text.split())
    assert run_json("status", "sim://vc660@1", "--model", "vc660", "--address", "1")["identity"] is None


@pytest.mark.parametrize(("model", "frame"), [("c320", "32 31 30 30"), ("vc660", "20 00 00 40")])
def test_a_quick_stop_sends_the_models_own_fast_stop(model: str, frame: str) -> None:
    """It is not offered for all drives at once, nor by a model without one."""
    words = (f"sim://{model}@1", "--model", model, "--address", "1", "--quick")
    planned = run_json("stop", *words, "--dry-run")
    assert frame in planned["frames"][0]["hex"]
    assert run_json("stop", *words)["outcome"] == "confirmed"
    for option in (["--all"], ["--group", "fans"]):
        refused = run_json("stop", *option, *words, code=2)["error"]
        assert refused["key"] == "stop_all.not_quick" and f"with {option[0]} every" in refused["text"]
    assert run_json("stop", "sim://df800@1", "--model", "df800", "--address", "1", "--quick", code=1)["error"]


def test_a_bus_stop_lists_confirmed_and_acknowledged_drives() -> None:
    found = run_json("stop", "--all", "sim://c320@1-2", "--model", "c320", "--address", "1-2")
    assert found["confirmed"] == [1, 2]
    assert found["unconfirmed"] == []
    acknowledged = run_json("stop", "--all", "sim://df800@1", "--model", "df800", "--address", "1")
    assert acknowledged["acknowledged"] == [1]


def test_a_bus_stop_of_an_absent_drive_that_was_named_exits_with_4() -> None:
    found = run_json("stop", "--all", "sim://vc660@1", "--model", "vc660", "--address", "1-2", code=4)
    assert found["confirmed"] == [1]
    assert found["unconfirmed"] == [2]


def test_scan_prints_the_drives_and_that_it_only_reads() -> None:
    result = CliRunner().invoke(
        cli,
        ["scan", "sim://vc660@2", "--models", "vc660", "--addresses", "1-3", "--listen-seconds", "0.1", "--lang", "en"],
    )
    assert result.exit_code == 0
    assert "vc660" in result.stdout
    assert "Only reads are sent" in result.stderr
    assert "communication-loss timer" in result.stderr


@pytest.fixture
def polled_line() -> Iterator[str]:
    """A TCP port on which requests of another master are received as soon as it is opened."""

    class Line(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(bytes.fromhex("05 03 30 00 00 01 8A 8E"))
            while self.request.recv(64):
                pass

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Line) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}).start()
        yield f"tcp://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def test_scan_names_another_master_and_sends_nothing_without_force(polled_line: str) -> None:
    words = ("--models", "vc660", "--addresses", "3", "--bauds", "9600", "--formats", "8N1", "--lang", "en")
    listens = ("--listen-seconds", "0.2")
    foreign = i18n.text("scan.foreign", "en", count=8, seconds="0.2")
    end = "Nothing was sent: requests would collide"
    text = run_text("scan", polled_line, *words, *listens, code=1)
    assert foreign in text and end in text and "Only reads are sent" not in text
    text = run_text("scan", polled_line, *words, *listens, "--force", code=1)
    assert foreign in text and end not in text and "Only reads are sent" in text
    text = run_text("scan", "sim://vc660@3", *words, *listens)
    assert "Another master" not in text and end not in text


def test_a_scan_of_an_empty_bus_exits_with_1_and_names_what_to_check() -> None:
    words = (
        "scan",
        "sim://vc660@9",
        "--models",
        "vc660",
        "--addresses",
        "1-2",
        "--listen-seconds",
        "0",
        "--lang",
        "en",
    )
    assert "A/B" in run_text(*words, "--bauds", "9600", "--formats", "8N1", code=1)


def test_models_lists_every_profile_with_its_grade() -> None:
    found = {profile["model"]: profile["grade"] for profile in run_json("models")["models"]}
    assert {"c320", "dzb100", "vc660", "df800"} <= set(found)
    assert found["c300"] == "draft"


@pytest.mark.parametrize(
    ("search", "expected"),
    [
        ("goodrive3", {"gd300", "gd35", "gd350"}),
        ("invt chf", {"chf100a"}),
        ("英威腾 350", {"gd350"}),
        ("Sunfar modbus", {"e300_modbus", "e500_modbus", "e550_modbus"}),
        ("no such maker", set()),
    ],
)
def test_models_are_searched_by_name_maker_and_title_in_both_languages(search: str, expected: set[str]) -> None:
    assert {profile["model"] for profile in run_json("models", "--search", search)["models"]} == expected


def test_a_search_without_a_model_says_so() -> None:
    assert "no such maker" in run_text("models", "--search", "no such maker")


def test_an_invalid_own_profile_is_reported_and_hides_no_other(own_profiles: Path) -> None:
    """Each file is reported once, with line, key and remedy where they are known."""
    (own_profiles / "good.toml").write_text('format = 1\nextends = "c320"\n')
    (own_profiles / "typo.toml").write_text('format = 1\nextends = "c320"\n[limits]\nmaximum_herz = 60.0\n')
    (own_profiles / "vc660.toml").write_text('format = 1\nextends = "df800"\n')
    (own_profiles / "folder.toml").mkdir()
    document = run_json("models", code=2)
    assert {"c320", "df800", "good"} <= {profile["model"] for profile in document["models"]}
    refused = {Path(refusal["params"]["file"]).name: refusal["params"] for refusal in document["refused"]}
    assert len(document["refused"]) == len(refused) == 3
    typo = refused["typo.toml"]
    assert (typo["line"], typo["key"], bool(typo["remedy"])) == (4, "limits.maximum_herz", True)
    assert [refused[name]["diagnostics"][0]["kind"] for name in ("vc660.toml", "folder.toml")] == [
        "shadows",
        "folder",
    ]
    result = CliRunner().invoke(cli, ["models", "--lang", "en"])
    assert result.exit_code == 2
    assert "good" in result.stdout and "typo.toml:4" in result.stderr and "limits.maximum_herz" in result.stderr


def test_models_lists_each_value_of_the_option_model_once(own_profiles: Path) -> None:
    """A file without ``model =`` contains the model name of its base."""
    (own_profiles / "mine.toml").write_text('format = 1\nextends = "c320"\n')
    names = [profile["model"] for profile in run_json("models")["models"]]
    assert names.count("c320") == 1 and names[-1] == "mine"
    for name in names:
        assert run_json("profile", "check", str(profiles.load(name).source))["valid"]


def test_ports_also_works_on_a_machine_without_serial_ports() -> None:
    assert isinstance(run_json("ports")["ports"], list)


def test_ports_names_an_adapter_that_holds_bytes_back_and_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An FTDI adapter with its factory setting, one set to 1 ms, and one without the timer."""
    install_latency_timers(tmp_path, monkeypatch, ttyUSB7=16, ttyUSB8=1)
    devices = [f"/dev/{name}" for name in ("ttyUSB7", "ttyUSB8", "ttyACM0")]
    found = [
        discovery.PortInfo(device=device, description="", identity=f"device:{device}", url=device) for device in devices
    ]
    monkeypatch.setattr(discovery, "discover_ports", lambda: found)
    assert [port["latency_ms"] for port in run_json("ports")["ports"]] == [16, 1, None]
    result = CliRunner().invoke(cli, ["ports"])
    noted = " ".join(result.stderr.split())
    assert "devices/ttyUSB7/latency_timer" in noted and "16 ms" in noted
    assert "ttyUSB8" not in noted and "ttyACM0" not in noted
    assert "".join(i18n.text("ports.latency", device="ttyUSB7", ms=16).split()) in "".join(result.stderr.split())


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_rejected_profile_is_reported_with_file_and_line_and_exits_with_2(tmp_path: Path, language: str) -> None:
    bad = tmp_path / "mine.toml"
    bad.write_text('format = 1\nextends = "c320"\nfamily = "no-family"\n')
    result = CliRunner().invoke(cli, ["profile", "check", str(bad), "--lang", language])
    assert result.exit_code == 2
    (line,) = [line for line in result.stderr.splitlines() if "no-family" in line]
    assert line.startswith(f"{bad}:3") and "family" in line and ("应为" in line) is (language == "zh")


def test_a_valid_profile_is_reported_as_valid(tmp_path: Path) -> None:
    good = tmp_path / "mine.toml"
    good.write_text('format = 1\nextends = "vc660"\nmodel = "mine"\n')
    found = CliRunner().invoke(cli, ["profile", "check", str(good), "--json"])
    if found.exit_code != 0:
        pytest.fail(found.output)
    assert json.loads(found.stdout)["valid"] is True


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("ttyUSB0", "/dev/ttyUSB0"),
        ("192.168.1.50:4001", "tcp://192.168.1.50:4001"),
        ("sim://c999@1", "c320"),
        ("tcp://host", "tcp://HOST:PORT"),
    ],
)
def test_the_error_of_an_invalid_port_url_suggests_a_valid_one(url: str, text: str) -> None:
    result = CliRunner().invoke(cli, ["status", url, *C320, "--lang", "en"])
    assert result.exit_code == 2
    assert text in result.stderr


def test_the_error_of_a_missing_port_names_the_next_step() -> None:
    result = CliRunner().invoke(cli, ["status", "/dev/ttyUSB99", *C320, "--lang", "en"])
    assert result.exit_code == 1
    assert "/dev/ttyUSB99" in result.stderr
    assert "plug the adapter in" in result.stderr


def test_the_error_of_an_unknown_option_name_lists_the_known_ones() -> None:
    found = run_json("status", "sim://dzb100@1", "--model", "dzb100", "--address", "1", "--option", "speed=9", code=2)
    assert "setpoint_coding" in found["error"]["text"]


def test_run_rejects_a_frequency_above_the_cap_until_the_coding_is_calibrated() -> None:
    """Under another coding the motor would turn ten times too fast."""
    words = ("run", "sim://dzb100@1", "--model", "dzb100", "--address", "1", "--frequency", "20")
    found = run_json(*words, code=1)
    assert found["error"]["type"] in ("LimitError", "StartInhibited")


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.ConfigurationError("x"), 2),
        (errors.PortUrlError("x"), 2),
        (errors.ProfileError("x"), 2),
        (errors.ChecksumError("x"), 3),
        (errors.NoReply("x"), 1),
        (errors.PortUnavailable("x"), 1),
        (errors.DriveRejected("x"), 1),
        (errors.TargetNotReached("x"), 1),
        (errors.OutcomeUnknown("x"), 4),
        (errors.StopUnconfirmed("x"), 4),
    ],
)
def test_each_error_has_its_exit_code(error: errors.DrivebusError, code: int) -> None:
    assert cli_errors.exit_code_of(error) == code


def test_a_run_whose_reads_before_the_start_are_damaged_sends_no_stop_to_a_drive_that_others_may_run() -> None:
    """As after a missing reply: nothing was sent that the end of the command would have to undo."""
    result = CliRunner().invoke(
        cli, ["run", "sim://c320@1?line_quality=junk=1", "--model", "c320", "--address", "1", "--frequency", "5"]
    )
    assert result.exit_code == 3, result.output
    assert i18n.text("run.stopping") not in result.output and "STOP" not in result.output


def test_a_bus_stop_without_addresses_stops_the_present_drives_and_counts_the_absent_addresses() -> None:
    found = run_json("stop", "--all", "sim://c320@1-2", "--model", "c320", "--baud", "19200")
    assert found["confirmed"] == [1, 2]
    assert len(found["absent"]) == 29
    assert found["text"].endswith(i18n.text("bus_stop.absent", count=29))


def test_a_bus_stop_of_named_addresses_counts_no_other_address_as_absent() -> None:
    found = run_json("stop", "--all", "sim://c320@1-2", "--model", "c320", "--address", "1-2", "--baud", "19200")
    assert (found["absent"], found["text"]) == ([], i18n.text("bus_stop.confirmed", addresses="1, 2"))


def test_an_e300_that_is_named_a_c320_is_not_run_ten_times_too_fast() -> None:
    """The frames are alike and every read-back would agree; a drive at a real port states nothing of itself."""
    words = ("run", "sim://e300@3", "--model", "c320", "--address", "3", "--frequency", "5")
    real_port = ("--option", "setpoint_step=unknown")
    assert run_json(*words, *real_port, code=1)["error"]["key"] == "drives.step_cap"
    error = run_json(*words, code=1)["error"]
    assert error["key"] == "drives.step_differs" and "--model" in error["hint"]


ONE_PROBE = ("--addresses", "3", "--bauds", "9600", "--formats", "8E1", "--listen-seconds", "0")


def test_scan_names_every_model_that_the_bus_can_not_tell_apart() -> None:
    words = ("scan", "sim://e300@3?drives=9600-8E1", *ONE_PROBE)
    [drive] = run_json(*words)["found"]
    assert (
        drive["models"] == ["c320", "c300", "e300", "e350", "e500", "e550"]
        and drive["doubtful"]
        and drive["valid_reply"]
    )
    assert {drive["setpoint_steps_hz"][model] for model in ("c320", "e300")} == {0.01, 0.1}
    text = run_text(*words, "--models", "c320", "--lang", "en")
    steps = [
        i18n.text("scan.step", models=models, step=step)
        for models, step in (("c320, c300", "0.01"), ("e300, e500, e550", "0.1"))
    ]
    shown = " ".join(text.split())
    assert steps == ["c320, c300 count 0.01 Hz", "e300, e500, e550 count 0.1 Hz"] and "; ".join(steps) in shown
    assert "; ".join([steps[-1], i18n.text("scan.step_unknown", models="e350")]) in shown
    assert i18n.text("scan.no_valid_reply") not in shown
    zh = " ".join(run_text(*words, "--models", "c320", "--lang", "zh").split())
    assert i18n.text("scan.step", "zh", models="c320、c300", step="0.01") in zh


def test_scan_without_models_names_a_drive_of_a_less_common_make() -> None:
    """Regression: the default knew 15 models, and a Goodrive 10 was a VC660 without doubt."""
    words = ("scan", "sim://gd10@2?drives=19200-8E1", "--addresses", "2", "--listen-seconds", "0")
    [drive] = run_json(*words)["found"]
    assert drive["models"] == ["gd10"] and not drive["doubtful"]


@pytest.mark.parametrize("model", ["fr_a700", "dzb100"])
def test_a_scan_of_all_models_takes_no_drive_for_the_first_of_those_that_answer_alike(model: str) -> None:
    """Regression: a FR-A700 was found as a FR-E500, without a note."""
    settings = ("--addresses", "3", "--bauds", "9600", "--formats", "8N2,8E1", "--listen-seconds", "0")
    text = run_text("scan", f"sim://{model}@3?baud=9600", *settings, "--encoding", "ascii", "--lang", "en")
    assert model in text and ("alike on the bus: see the name plate" in " ".join(text.split())) is (model == "fr_a700")


def test_scan_fails_where_only_bytes_without_a_valid_reply_were_received() -> None:
    words = ("scan", "sim://c320@3?drives=9600-8E1&line_quality=junk=1", *ONE_PROBE, "--encoding", "ascii")
    found = run_json(*words, code=1)["found"]
    assert found and not any(drive["valid_reply"] for drive in found)
    text = run_text(*words, "--lang", "en", code=1)
    assert text.count("stray bytes come before its reply") == len(found) == 1
    assert "stray bytes come before its reply" in found[0]["unusable_reply"]
