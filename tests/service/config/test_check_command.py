"""``drivebus check``: errors of a plant file, load of its buses, requirements, exit codes; nothing is opened."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus.cli.main import cli
from drivebus.service import config
from drivebus.service.config import bus_load
from drivebus.service.config.bus_load import bus_loads
from fixtures.service import FAN_FILE
from fixtures.usb_serial import install_latency_timers

REJECTED = Path(__file__).parents[1] / "rejected"
PLANT = (
    FAN_FILE
    + """signals = { output_frequency = 0.5, output_voltage = 2.0 }
[bus.b]
port = "tcp://127.0.0.1:2"
[drive.conveyor]
bus = "b"
address = 1
model = "dzb100"
"""
)


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_text(PLANT)
    return path


def check(*words: Any) -> Result:
    return CliRunner().invoke(cli, ["check", *(str(word) for word in words)])


def test_a_valid_plant_is_reported_with_its_bus_load(plant: Path) -> None:
    result = check(plant)
    assert result.exit_code == 0
    assert "Buses: 2, drives: 2" in result.output
    assert "500 ms (≤ 643 ms): output_frequency · 2 s (≤ 2.14 s): output_voltage" in result.output
    assert "conveyor is polled at most every 750 ms" in result.output


def test_an_adapter_that_holds_bytes_back_is_named_with_its_cost_and_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An FTDI adapter with its factory setting of 16 ms, and one of 1 ms that costs nothing."""
    install_latency_timers(tmp_path, monkeypatch, ttyUSB7=16, ttyUSB8=1)
    plant = tmp_path / "plant.toml"
    plant.write_text(PLANT.replace("tcp://127.0.0.1:1", "/dev/ttyUSB7").replace("tcp://127.0.0.1:2", "/dev/ttyUSB8"))
    (found,) = json.loads(check(plant, "--json").stdout)["slow_adapters"]
    assert (found["bus"], found["device"], found["latency_ms"]) == ("a", "ttyUSB7", 16)
    assert 1 / found["polls_per_s"] - 1 / found["polls_per_s_at_low_latency"] == pytest.approx(0.015)
    shown = " ".join(check(plant).output.split())
    assert "bus a: the adapter ttyUSB7" in shown
    assert f"At most {found['polls_per_s']:.1f} polls a second instead of" in shown
    assert "devices/ttyUSB8" not in shown
    assert "/sys/bus/usb-serial/devices/ttyUSB7/latency_timer" in shown and 'ATTR{latency_timer}="1"' in shown


@pytest.mark.parametrize(("language", "word"), [("en", "Warning: "), ("zh", "警告：")])
def test_an_interval_that_may_be_milliseconds_is_a_warning_of_a_valid_plant(
    plant: Path, language: str, word: str
) -> None:
    plant.write_text(PLANT.replace("output_frequency = 0.5", "output_frequency = 500"))
    result = check(plant, "--lang", language)
    assert result.exit_code == 0
    line = PLANT.split("signals")[0].count("\n") + 1
    location = {"en": f"{plant}:{line}: drive", "zh": f"{plant}:{line}：drive"}[language]
    assert "".join(f"{word}{location}".split()) in "".join(result.stderr.split())
    (found,) = json.loads(check(plant, "--json").stdout)["warnings"]
    assert (found["line"], found["key"], found["found"]) == (line, "drive.fan.signals.output_frequency", "500")


def test_an_invalid_plant_is_reported_with_every_fault_and_exit_code_2() -> None:
    result = check(REJECTED / "many-faults.toml", "--json")
    assert result.exit_code == 2
    found = json.loads(result.stdout)
    assert (found["exit"], found["error"]["params"]["count"]) == (2, 8)
    first = found["error"]["params"]["diagnostics"][0]
    assert (first["line"], first["key"], first["found"]) == (6, "bus.a.speed", '"speed"')
    assert all(first[name] for name in ("expected", "remedy"))


def test_a_history_on_postgresql_needs_its_package_and_the_check_names_it(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant.write_text(PLANT + '[history]\nurl = "postgresql://127.0.0.1/plant"\n')
    monkeypatch.setattr("drivebus.cli.commands.check.find_spec", lambda name: None)
    result = check(plant)
    assert result.exit_code == 1
    assert "asyncpg" in result.output and "'.[server,postgres]'" in result.output
    monkeypatch.setattr("drivebus.cli.commands.check.find_spec", lambda name: object())
    assert check(plant).exit_code == 0


def test_met_requirements_are_printed_and_leave_the_exit_code_0(plant: Path) -> None:
    result = check(plant, "--assert", "stop<250ms", "--assert", "refresh <= 63 s", "--assert", "load<100%")
    assert result.exit_code == 0
    assert result.output.count("Met: ") == 3


def test_a_missed_requirement_names_the_drive_and_both_numbers(plant: Path) -> None:
    result = check(plant, "--assert", "stop<95ms", "--assert", "refresh<2s")
    assert result.exit_code == 1
    assert "drive conveyor: stop within 204 ms, < 95 ms required" in result.output
    assert "drive fan: stop" not in result.output
    assert "drive fan: output_voltage refreshed every 2.14 s, < 2 s required" in result.output


def test_the_json_output_has_each_requirement_with_the_figures_that_violate_it(plant: Path) -> None:
    result = check(plant, "--json", "--assert", "load<=30%")
    found = json.loads(result.stdout)
    assert (result.exit_code, found["exit"], found["valid"]) == (1, 1, True)
    assert [(bus["bus"], bus["serial"]) for bus in found["buses"]] == [("a", "9600 8E1"), ("b", "4800 8E1")]
    requirement = found["requirements"][0]
    assert (requirement["requirement"], requirement["met"]) == ("load<=30%", False)
    assert [(violation["name"], violation["found"]) for violation in requirement["violations"]] == [
        ("b", pytest.approx(found["buses"][1]["load_percent"], abs=0.001))
    ]


@pytest.mark.parametrize("text", ["stop<250", "stop>250ms", "load<2s", "stop<5%", "speed<2s", "", "stop<ms"])
def test_an_invalid_requirement_is_a_usage_error(plant: Path, text: str) -> None:
    result = check(plant, "--assert", text)
    assert result.exit_code == 2
    assert "stop<250ms, refresh<2s or load<80%" in result.output


def test_a_requirement_is_parsed_in_seconds_and_percent() -> None:
    assert bus_load.parse_requirement("stop<250ms").limit == 0.25
    assert (
        bus_load.parse_requirement(" load <= 80 % ").limit,
        bus_load.parse_requirement("load<=80%").sign,
    ) == (
        80.0,
        "<=",
    )


def test_the_stop_bound_is_the_longest_request_its_timeout_the_gap_and_the_stop() -> None:
    """A C320 at 9600 8E1: 18 characters of request, 18 of reply."""
    bus = bus_loads(config.loads(PLANT))[0]
    assert bus.stop_bound_s == bus.drives[0].stop_bound_s == pytest.approx(0.0933, abs=1e-3)
    assert bus.load_percent == pytest.approx(sum(drive.load_percent for drive in bus.drives))


def test_a_bus_without_configured_periods_is_never_overloaded() -> None:
    """Every drive of the model's whole range of addresses, each with all its signals, on one line."""
    drives = "".join(f'[drive.d{n}]\nbus = "a"\naddress = {n}\nmodel = "c320"\n' for n in range(31))
    text = f'format = 1\n[plant]\nid = "p"\n[bus.a]\nport = "tcp://127.0.0.1:1"\n{drives}'
    bus = bus_loads(config.loads(text))[0]
    assert 50 < bus.load_percent <= 100
    assert {drive.min_poll_interval_s for drive in bus.drives} == {10.0}
    assert bus.drives[0].periods["output_frequency"] == 10.0
    assert bus.drives[0].periods["last_fault_temperature"] == 60.0
    assert bus.drives[0].refresh["output_frequency"] == pytest.approx(10.0 + bus.cycle_s)


def test_what_a_file_asks_for_is_never_slowed_down_behind_its_back() -> None:
    paced = PLANT.replace('model = "dzb100"', 'model = "dzb100"\nmin_poll_interval_s = 2.0')
    drives = {drive.drive: drive.min_poll_interval_s for bus in bus_loads(config.loads(paced)) for drive in bus.drives}
    assert drives == {"fan": 0.0, "conveyor": 2.0}
