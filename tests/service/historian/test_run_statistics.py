"""Run statistics: only what was seen counts, and what a drive does not report is None."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.service.live.views import CommLossView, DriveView, SignalView
from drivebus.service.runtime.run_statistics import (
    DOCUMENT_KIND,
    LOAD_RETRY_S,
    MAX_OBSERVATION_GAP_S,
    SAVE_INTERVAL_S,
    RunStatistics,
    RunStatisticsStore,
)
from drivebus.testing import virtual_time
from drivebus.values import Quality, Text
from fixtures.historian import NOON_MS, HistoryDatabase

NOTHING = Text("", "")


def view(state: str = "running", fault: str | None = None, presence: str = "online", **signals: Any) -> DriveView:
    """``signals``: name → value, or → (value, unit, quality)."""
    units = {"output_power": "kW", "output_current": "A", "temperature": "°C"}
    found = {
        name: SignalView(*(given if isinstance(given, tuple) else (given, units[name], Quality.GOOD)), None, 0.0)
        for name, given in signals.items()
    }
    return DriveView(
        "fan-1",
        NOTHING,
        "a",
        1,
        "c320",
        "simulated",
        (),
        (),
        presence,
        state,
        None,
        None,
        None if fault is None else {"code": fault},
        None,
        0.0,
        50.0,
        CommLossView("unknown", None, NOTHING),
        signals=found,
    )


def seen(*looks: DriveView, step_s: float = 1.0) -> RunStatistics:
    found = RunStatistics()
    for n, look in enumerate(looks):
        found.observe(look, 100.0 + n * step_s, NOON_MS + n)
    return found


def test_hours_count_while_the_drive_says_that_it_turns() -> None:
    turning = ["accelerating", "running", "decelerating", "jogging", "braking"]
    found = seen(*map(view, ["stopped", *turning, "stopped", "fault", "paused", "stopped"]))
    assert (found.running_s, found.starts) == (4.0, 1)


def test_an_unobserved_start_counts_but_an_adopted_run_does_not() -> None:
    assert seen(view("unknown"), view("running")).starts == 0
    assert seen(view("stopped"), view("unknown"), view("running"), view("unknown"), view("running")).starts == 1


@pytest.mark.parametrize(
    ("step_s", "hours"), [(MAX_OBSERVATION_GAP_S, MAX_OBSERVATION_GAP_S), (MAX_OBSERVATION_GAP_S + 0.1, 0.0)]
)
def test_a_pause_between_two_looks_is_not_guessed(step_s: float, hours: float) -> None:
    found = seen(view("running", output_power=2.0), view("running", output_power=2.0), step_s=step_s)
    assert found.running_s == pytest.approx(hours)
    assert found.energy_kwh == pytest.approx(hours * 2.0 / 3600)


def test_a_silent_drive_and_one_without_a_state_have_no_hours() -> None:
    silent = seen(view("running", presence="offline"), view("running", presence="offline"))
    unknown = seen(view("unknown"), view("unknown"))
    for found in (silent, unknown):
        assert (found.as_json()["running_h"], found.as_json()["starts"]) == (None, None)


def test_energy_is_the_power_of_each_look_and_what_is_given_back_is_taken_off() -> None:
    powers = [3.6, 3.6, -1.8, 0.0]
    found = seen(*(view(output_power=power) for power in powers), step_s=1.0)
    assert found.energy_kwh == pytest.approx(0.001 + 0.001 - 0.0005)
    assert seen(view(output_power=0.0)).as_json()["energy_kwh"] == 0.0


def test_a_value_without_scale_or_trust_is_no_energy_current_or_temperature() -> None:
    doubtful: list[Any] = [(5.0, "", Quality.GOOD), (5.0, "kW", Quality.UNCERTAIN), (None, "kW", Quality.BAD)]
    for power in doubtful:
        assert seen(view(output_power=power), view(output_power=power)).energy_kwh is None
    found = seen(view(output_current=(120, "", Quality.UNCERTAIN), temperature=(99.0, "°C", Quality.BAD)))
    assert (found.maximum_current_a, found.maximum_temperature_c) == (None, None)


def test_peaks_stay() -> None:
    found = seen(*(view(output_current=amps, temperature=2 * amps) for amps in (1.0, 7.5, 3.0)))
    assert (found.maximum_current_a, found.maximum_temperature_c) == (7.5, 15.0)


def test_a_fault_counts_once_while_it_stands_and_again_when_it_returns() -> None:
    stands, gone = view("fault", fault="E-3"), view("stopped")
    found = seen(stands, stands, view("unknown"), stands, gone, stands, view("fault", fault="E-7"))
    assert found.faults == {"E-3": 2, "E-7": 1}


def test_a_restart_goes_on_where_it_was() -> None:
    before = seen(view("running", output_power=3.6), view("fault", fault="E-3", output_power=3.6))
    after = RunStatistics.from_document({**before.to_document(), "a field of tomorrow": 1})
    after.observe(view("fault", fault="E-3"), 5.0, NOON_MS + 9)
    after.observe(view("running"), 6.0, NOON_MS + 9)
    assert (after.faults, after.starts, after.since_ms) == ({"E-3": 1}, 1, NOON_MS)
    assert after.energy_kwh == pytest.approx(0.001)


async def test_statistics_survive_in_the_history(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        book = RunStatisticsStore(historian)
        await book.open()
        for n in range(int(SAVE_INTERVAL_S) + 2):
            book.on_view(view("running"), float(n), NOON_MS)
        await historian.flush()
        kept = await historian.documents(DOCUMENT_KIND)
        assert kept["fan-1"]["running_s"] == SAVE_INTERVAL_S
        await book.close()
    async with database.historian() as historian:
        book = RunStatisticsStore(historian)
        await book.open()
        answer = await book.handlers()["drives.statistics"](type("Of", (), {"drive": "fan-1"}), None)
    assert answer["running_h"] == pytest.approx((SAVE_INTERVAL_S + 1) / 3600, abs=1e-4)


def test_numbers_that_can_not_be_read_yet_are_read_later_and_never_written_over() -> None:
    class Keeper:
        away = True
        kept: dict[str, Any] = {"fan-1": {"running_s": 7.0, "turned": True}}

        def put_document(self, kind: str, id: str, value: Any) -> None:
            self.kept[id] = value

        async def documents(self, kind: str) -> dict[str, Any]:
            if self.away:
                raise ServiceUnavailable("history.unavailable", why="away")
            return dict(self.kept)

    async def scenario() -> None:
        keeper = Keeper()
        book = RunStatisticsStore(keeper)
        await book.open()
        for n in range(200):
            book.on_view(view("running"), float(n), NOON_MS)
        assert keeper.kept["fan-1"]["running_s"] == 7.0
        keeper.away = False
        await asyncio.sleep(LOAD_RETRY_S + 0.1)
        for n in range(3):
            book.on_view(view("running"), 200.0 + n, NOON_MS)
        await book.close()
        assert keeper.kept["fan-1"]["running_s"] == 9.0

    virtual_time.run(scenario())
