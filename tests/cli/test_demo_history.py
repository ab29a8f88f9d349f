"""The generated history of the demo: reproducible, in order of time, with the signals of the profile only."""

from __future__ import annotations

import os
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.cli.demo import host
from drivebus.cli.demo.history import (
    HISTORY_HOURS,
    SAMPLE_INTERVAL_S,
    HistoryGenerator,
    number_alarms,
    past_alarms,
    past_statistics,
)
from drivebus.cli.demo.host import free_port
from drivebus.cli.demo.layout import BUSES
from drivebus.profiles.model import DriveProfile
from drivebus.service.config.model import DriveConfig
from drivebus.service.live.views import Sample
from drivebus.service.runtime.run_statistics import RunStatistics
from drivebus.values import Quality, Text
from fixtures.child_process import ENVIRONMENT, PtyTerminal

START_MS = 1_700_000_000_000
STEPS = int(HISTORY_HOURS * 3600.0 / SAMPLE_INTERVAL_S)


def generator(bus: int = 2, drive: int = 0, seed: int = 1) -> HistoryGenerator:
    return HistoryGenerator(BUSES[bus], BUSES[bus].drives[drive], profiles.load(BUSES[bus].model), START_MS, seed)


def test_the_same_seed_gives_the_same_history_and_another_seed_a_different_one() -> None:
    first, again, other = (list(generator(seed=seed).samples()) for seed in (1, 1, 2))
    assert first == again != other


def test_every_signal_has_a_value_every_ten_seconds_for_eight_hours() -> None:
    found = list(generator().samples())
    assert set(Counter(sample.tag for sample in found).values()) == {STEPS}
    assert {sample.tag.partition(".")[0] for sample in found} == {BUSES[2].drives[0].key}
    times = [sample.time_ms for sample in found]
    assert times == sorted(times) and times[-1] - times[0] == (STEPS - 1) * int(SAMPLE_INTERVAL_S * 1000)


def test_a_history_has_only_signals_that_the_profile_lists() -> None:
    for index, bus in enumerate(BUSES):
        listed = profiles.load(bus.model).signals
        found = {sample.tag.partition(".")[2]: sample.quality for sample in generator(index).samples()}
        assert found and set(found) <= set(listed)
        assert {name for name, quality in found.items() if quality is not Quality.GOOD} == {
            name for name in found if listed[name].uncertain
        }


def test_a_motor_draws_current_only_while_it_runs() -> None:
    history = generator(1)
    values: dict[str, list[float]] = {}
    for sample in history.samples():
        assert sample.value is not None
        values.setdefault(sample.tag.partition(".")[2], []).append(sample.value)
    pairs = list(zip(values["output_frequency"], values["output_current"], strict=True))
    running = [hz for hz, _ in pairs if hz > 0.0]
    assert 0.2 < len(running) / STEPS < 0.98 and max(running) <= 50.0
    assert all((hz > 0.0) == (amperes > 0.0) for hz, amperes in pairs)
    assert {event.kind for event in history.events} >= {"run", "stop"}


def shift(bus: int, drive: int) -> tuple[DriveConfig, DriveProfile, HistoryGenerator, list[Sample]]:
    history = generator(bus, drive)
    made, profile = BUSES[bus], profiles.load(BUSES[bus].model)
    fan = made.drives[drive]
    setting = DriveConfig(id=fan.key, bus=made.name, address=fan.address, model=made.model, title=Text("Fan", "风机"))
    return setting, profile, history, list(history.samples())


SHIFTS = [(bus, drive) for bus in range(len(BUSES)) for drive in range(3)]


def test_each_trip_of_the_history_is_an_alarm_that_was_acknowledged_and_cleared() -> None:
    """Trips in the trend beside an empty list of past alarms made the demo look broken."""
    alarms = []
    for setting, profile, history, _ in (shift(bus, drive) for bus, drive in SHIFTS):
        made = [*past_alarms(setting, profile, history.events, "demo")]
        ended = [event for event in history.events[:-1] if event.kind == "trip"]
        assert [alarm.raised_ms for alarm in made] == [event.time_ms for event in ended]
        alarms += made
    ordered = number_alarms(alarms)
    assert len(ordered) >= 3
    assert [alarm.id for alarm in ordered] == [f"a{n}" for n in range(1, len(ordered) + 1)]
    assert [alarm.raised_ms for alarm in ordered] == sorted(alarm.raised_ms for alarm in ordered)
    for alarm in ordered:
        assert not alarm.active and alarm.acknowledged_by == "demo"
        assert alarm.raised_ms < (alarm.acknowledged_ms or 0) <= (alarm.cleared_ms or 0)
        assert alarm.text.en.startswith("Fan reports a fault: ") and alarm.remedy.en


def test_the_events_of_the_history_name_their_drive_as_the_page_does() -> None:
    history = generator()
    list(history.samples())
    found = host._event_json(history.events[0], 0, Text("spindle 1", "主轴 1"), profiles.load("vc660"))
    assert found["text"]["en"].startswith("spindle 1:") and found["text"]["zh"].startswith("主轴 1：")


def test_a_trip_of_the_history_names_its_fault_as_one_of_a_drive_does() -> None:
    """Regression: the list of a drive's faults had *its motor jams …* for a fault of some hours ago."""
    for _, profile, history, _ in (shift(bus, drive) for bus, drive in SHIFTS if BUSES[bus].model == "dzb100"):
        for event in history.events:
            text = host._event_json(event, 0, Text("Fan", "风机"), profile)["text"]
            named = (text["en"] == "fault E005: over-current while running", text["zh"] == "故障 E005：运转中过电流")
            assert named == (event.kind == "trip", event.kind == "trip")


def test_the_statistics_count_the_hours_of_the_history() -> None:
    for setting, profile, history, samples in (shift(bus, drive) for bus, drive in SHIFTS):
        found = past_statistics(profile, samples, history.events, START_MS)
        shown = found.as_json()
        frequencies = [sample.value or 0.0 for sample in samples if sample.tag.endswith(".output_frequency")]
        assert shown["since_ms"] == START_MS
        if "status" not in profile.capabilities:
            assert (shown["running_h"], shown["starts"]) == (None, None), setting.id
            continue
        assert shown["running_h"] == round(sum(hz > 0.0 for hz in frequencies) * SAMPLE_INTERVAL_S / 3600.0, 4)
        assert 1.0 < shown["running_h"] < HISTORY_HOURS and shown["starts"] >= 1
        assert sum(shown["faults"].values()) == sum(event.kind == "trip" for event in history.events)
        assert RunStatistics.from_document(found.to_document()) == found


def test_a_drive_without_readable_power_has_no_energy_and_one_with_it_has() -> None:
    energies = {
        BUSES[bus].model: past_statistics(profile, samples, history.events, START_MS).energy_kwh
        for bus in range(len(BUSES))
        for _, profile, history, samples in [shift(bus, 0)]
    }
    assert (energies["vc660"] or 0.0) > 0.1 and energies["c320"] is None


@pytest.mark.skipif(sys.platform == "win32", reason="signals and ptys of POSIX")
@pytest.mark.parametrize(
    ("number", "ctrl_c"),
    [
        (signal.SIGTERM, signal.default_int_handler),
        (signal.SIGHUP, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_IGN),  # a script started it with "&", and its SIGTERM was lost
    ],
)
def test_a_demo_that_is_ended_while_it_writes_its_history_removes_its_directory(
    number: signal.Signals, ctrl_c: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ENVIRONMENT, "TMPDIR", str(tmp_path))
    former = signal.signal(signal.SIGINT, ctrl_c)  # inherited where it is ignored
    try:
        terminal = PtyTerminal("demo", "--port", str(free_port(0)))
    finally:
        signal.signal(signal.SIGINT, former)
    with terminal:
        terminal.wait_for(i18n.text("demo.preparing", "en")[:20])
        os.kill(terminal.pid, number)
        assert terminal.exit_code() == 130
    assert list(tmp_path.iterdir()) == []
