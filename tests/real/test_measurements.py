"""Figures of ``benchmarks.stop``, ``.service`` and ``.profile_cpu``: stops reach the far end, and the arithmetic.

The figures themselves need a quiet machine and are in reports.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from cProfile import Profile
from pathlib import Path

import pytest

from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters, RegisterValues
from peers import need_program

ROOT = Path(__file__).resolve().parents[2]


def test_each_measured_stop_reaches_the_far_end() -> None:
    need_program("gcc", "gcc")
    options = ["--seconds", "2", "--lines", "2", "--burners", "0", "--runs", "1"]
    command = [sys.executable, "-m", "benchmarks.stop", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["stops"] > 0 and found["never_seen"] == 0
    assert found["bound_ms"]["of the product's bus load estimate"] == found["bound_ms"]["of the reference calculation"]
    machine = found["machine"]
    assert machine["sigterm"]["runs"] == machine["sigterm"]["started"] == 1 and machine["requests_per_s_answered"] > 0
    assert machine["latency_over_bound"]["p50"] <= machine["latency_over_bound"]["max"]


@pytest.mark.parametrize(
    ("late_s", "met"), [(0.0585, True), (0.0685, True), (0.07, False)], ids=["in time", "10 ms late", "later"]
)
def test_a_late_stop_misses_the_goal(late_s: float, met: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.latency import StopCall, WireRequest, figures_of

    read = WireRequest(9.999, 10.01, bytes.fromhex("0103300000040000"))
    stop = WireRequest(10.0 + late_s, 10.1, bytes.fromhex("0106200000020000"))
    other = WireRequest(10.0 + late_s - 0.01, 10.1, bytes.fromhex("0206200000020000"))
    host = dict.fromkeys(("unconfirmed", "requests_per_s", "request_ms", "occupied_percent", "gap_s"), 0.0)
    host |= {"bound_s": 0.0585 + 80 / 19200, "own_bound_s": 0.0585 + 80 / 19200, "timeout_s": 0.05}
    found = figures_of([StopCall(0, 1, 10.0, 10.0 + late_s, 1)], {0: [read, other, stop]}, host, 19200)
    assert (found["stops"], found["never_seen"]) == (1, 0)
    assert found["machine"]["goal_met"] is met
    assert found["machine"]["latency_minus_bound_ms"]["max"] == pytest.approx((late_s - 0.0585) * 1e3, abs=1e-3)
    assert found["machine"]["frames_written_between_call_and_stop"] == {1: 1}
    never = figures_of([StopCall(0, 3, 10.0, 0.0, 0), StopCall(0, 1, 10.0, 10.0, 0)], {0: [read, stop]}, host, 19200)
    assert never["never_seen"] == 1 and not never["machine"]["goal_met"]


READ = bytes.fromhex("0103300000040000")
STOP = bytes.fromhex("0106200000020000")


def test_a_refused_or_late_stop_of_the_service_misses_the_goal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.latency import WireRequest
    from benchmarks.wire_analysis import calls_by_interface, lateness_of_stops

    file = tmp_path / "calls"
    file.write_text("socket 0 1 10000000000 confirmed\nweb 0 1 11000000000 confirmed\nweb 0 3 11500000000 503\n")
    calls = calls_by_interface(file)
    stop_s = 80 / 19200
    frames = {
        0: [
            WireRequest(9.99, 10.0, READ),
            WireRequest(10.05, 10.06, STOP),
            WireRequest(10.99, 11.0, READ),
            WireRequest(11.08, 11.09, STOP),
        ]
    }
    by_socket, by_web = (lateness_of_stops(calls[name], frames, 0.06 + stop_s, 19200) for name in ("socket", "web"))
    assert by_socket["answers"] == {"confirmed": 1} and by_socket["goal_met"]
    assert by_socket["latency_minus_bound_ms"]["max"] == pytest.approx(-10.0)
    assert by_web["answers"] == {"503": 1, "confirmed": 1} and by_web["never_seen"] == 1
    assert by_web["latency_minus_bound_ms"]["max"] == pytest.approx(20.0) and not by_web["goal_met"]
    assert not lateness_of_stops(calls["web"][1:], frames, 0.06, 19200)["goal_met"]


def test_the_longest_pause_between_polls_includes_the_ends_of_the_window_and_drives_never_polled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.latency import WireRequest
    from benchmarks.wire_analysis import poll_intervals

    other = bytes.fromhex("0103300400010000")
    frames = [WireRequest(at, at + 0.01, READ) for at in (9.0, 10.5, 11.0, 11.5)] + [WireRequest(11.6, 11.7, other)]
    found = poll_intervals({0: frames}, [1], (10.0, 12.0))
    assert found == {"of_a_drive_per_s": 1.5, "longest_pause_s": 0.5, "frames_of_a_line_per_s": 2.0}
    assert poll_intervals({0: frames}, [1, 2], (10.0, 12.0))["longest_pause_s"] == 2.0


def test_a_flood_that_reduces_polls_or_grows_the_web_process_misses_the_goal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.service import WEB_MEMORY_MAX_MB, check_goals

    met = {"goal_met": True}
    normal = {"by_socket": met, "by_web": met, "polls": {"of_a_drive_per_s": 2.0}}

    def goals_met(polls: float, most_mb: float) -> list[bool]:
        web = {"web": {"memory_mb": {"most": most_mb}}}
        flood = {"by_socket": met, "by_web": met, "polls": {"of_a_drive_per_s": polls}, "processes": web}
        return list(check_goals({"normal": normal, "loaded": normal, "flood": flood}).values())

    assert goals_met(2.0, 100.0) == [True] * 8
    assert goals_met(1.8, 100.0) == [True] * 7 + [False]
    assert goals_met(2.0, WEB_MEMORY_MAX_MB) == [True] * 6 + [False, True]


def test_the_service_accepts_the_configuration_of_the_measured_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.service_fixture import drive_id, plant_text
    from drivebus.service.config.load import load

    file = tmp_path / "plant.toml"
    file.write_text(plant_text(tmp_path / "state", 8080, ["sim://vc660@1-8", "sim://vc660@1-8?seed=2"], 8, 19_200))
    found = load(str(file))
    assert [drive.id for drive in found.drives][7:9] == [drive_id(0, 8), drive_id(1, 1)]


def test_cpu_time_counts_for_its_package_and_a_built_in_function_for_its_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.profile_cpu import package_of, shares

    profile, codec = Profile(), ModbusRtuCodec()
    reply = codec.encode_reply(RegisterValues(1, 3, (1, 2, 3, 4)))
    profile.enable()
    for _ in range(200):
        codec.decode_reply(ReadRegisters(1, 0, 4), reply)
        os.getppid()
    profile.disable()
    packages, functions = shares(profile)
    assert packages["drivebus.protocols"] > 20 and packages["operating system"] > 0
    assert packages.keys() <= {"drivebus.protocols", "drivebus.protocols.codec", "operating system", "other"}
    assert 99 < sum(packages.values()) < 101 and any("decode_reply" in name for name in functions)
    assert (
        package_of("/x/lib/python3.12/asyncio/events.py") == "asyncio"
        and package_of("/x/drivebus/serial_settings.py") == "drivebus.serial_settings"
    )
