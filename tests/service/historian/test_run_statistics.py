"""Run statistics: only observations count, and values that a drive does not report are None."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.service.historian import Historian
from drivebus.service.historian.store import Document
from drivebus.service.live.views import DriveView, SignalView
from drivebus.service.runtime.run_statistics import (
    DOCUMENT_KIND,
    LOAD_RETRY_S,
    MAX_OBSERVATION_GAP_S,
    SAVE_INTERVAL_S,
    RunStatistics,
    RunStatisticsStore,
)
from drivebus.testing import virtual_time
from drivebus.values import Quality
from fixtures.alarms import view as drive_view
from fixtures.historian import NOON_MS, HistoryDatabase


def view(state: str = "running", fault: str | None = None, presence: str = "online", **signals: Any) -> DriveView:
    """``signals``: name → value, or → (value, unit, quality)."""
    units = {"output_power": "kW", "output_current": "A", "temperature": "°C"}
    found = {
        name: SignalView(*(value if isinstance(value, tuple) else (value, units[name], Quality.GOOD)), None, 0.0)
        for name, value in signals.items()
    }
    return drive_view(found, presence=presence, state=state, fault=None if fault is None else {"code": fault})


def observed(*views: DriveView, step_s: float = 1.0) -> RunStatistics:
    found = RunStatistics()
    for n, view in enumerate(views):
        found.observe(view, 100.0 + n * step_s, NOON_MS + n)
    return found


def test_hours_count_while_the_drive_reports_a_turning_motor() -> None:
    turning = ["accelerating", "running", "decelerating", "jogging", "braking"]
    found = observed(*map(view, ["stopped", *turning, "stopped", "fault", "paused", "stopped"]))
    assert (found.running_s, found.starts) == (4.0, 1)


def test_an_unobserved_start_counts_but_an_adopted_run_does_not() -> None:
    assert observed(view("unknown"), view("running")).starts == 0
    assert observed(view("stopped"), view("unknown"), view("running"), view("unknown"), view("running")).starts == 1


@pytest.mark.parametrize(
    ("step_s", "hours"), [(MAX_OBSERVATION_GAP_S, MAX_OBSERVATION_GAP_S), (MAX_OBSERVATION_GAP_S + 0.1, 0.0)]
)
def test_the_time_of_a_long_pause_between_observations_does_not_count(step_s: float, hours: float) -> None:
    found = observed(view("running", output_power=2.0), view("running", output_power=2.0), step_s=step_s)
    assert found.running_s == pytest.approx(hours)
    assert found.energy_kwh == pytest.approx(hours * 2.0 / 3600)


def test_an_offline_drive_and_one_without_a_state_have_no_hours() -> None:
    silent = observed(view("running", presence="offline"), view("running", presence="offline"))
    unknown = observed(view("unknown"), view("unknown"))
    for found in (silent, unknown):
        assert (found.as_json()["running_h"], found.as_json()["starts"]) == (None, None)


def test_energy_is_the_power_of_each_observation_less_that_of_braking() -> None:
    powers = [3.6, 3.6, -1.8, 0.0]
    found = observed(*(view(output_power=power) for power in powers), step_s=1.0)
    assert found.energy_kwh == pytest.approx(0.001 + 0.001 - 0.0005)
    assert observed(view(output_power=0.0)).as_json()["energy_kwh"] == 0.0


def test_a_value_without_scale_or_good_quality_does_not_count() -> None:
    not_good: list[Any] = [(5.0, "", Quality.GOOD), (5.0, "kW", Quality.UNCERTAIN), (None, "kW", Quality.BAD)]
    for power in not_good:
        assert observed(view(output_power=power), view(output_power=power)).energy_kwh is None
    found = observed(view(output_current=(120, "", Quality.UNCERTAIN), temperature=(99.0, "°C", Quality.BAD)))
    assert (found.maximum_current_a, found.maximum_temperature_c) == (None, None)


def test_a_lower_current_or_temperature_does_not_replace_the_maximum() -> None:
    found = observed(*(view(output_current=amps, temperature=2 * amps) for amps in (1.0, 7.5, 3.0)))
    assert (found.maximum_current_a, found.maximum_temperature_c) == (7.5, 15.0)


def test_a_fault_counts_once_while_present_and_again_when_it_returns() -> None:
    fault, gone = view("fault", fault="E-3"), view("stopped")
    found = observed(fault, fault, view("unknown"), fault, gone, fault, view("fault", fault="E-7"))
    assert found.faults == {"E-3": 2, "E-7": 1}


def test_statistics_continue_after_a_restart() -> None:
    before = observed(view("running", output_power=3.6), view("fault", fault="E-3", output_power=3.6))
    after = RunStatistics.from_document({**before.to_document(), "a field of tomorrow": 1})
    after.observe(view("fault", fault="E-3"), 5.0, NOON_MS + 9)
    after.observe(view("running"), 6.0, NOON_MS + 9)
    assert (after.faults, after.starts, after.since_ms) == ({"E-3": 1}, 1, NOON_MS)
    assert after.energy_kwh == pytest.approx(0.001)


async def test_statistics_survive_in_the_history(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        store = RunStatisticsStore(historian)
        await store.open()
        for n in range(int(SAVE_INTERVAL_S) + 2):
            store.on_view(view("running"), float(n), NOON_MS)
        stored = await _flushed_documents(historian)
        assert stored["fan-1"]["running_s"] == SAVE_INTERVAL_S
        await store.close()
    async with database.historian() as historian:
        store = RunStatisticsStore(historian)
        await store.open()
        answer = store.statistics_json("fan-1")
    assert answer["running_h"] == pytest.approx((SAVE_INTERVAL_S + 1) / 3600, abs=1e-4)


async def test_a_start_and_a_trip_are_saved_at_once_so_that_no_kill_loses_them(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        store = RunStatisticsStore(historian)
        await store.open()
        for n, status in enumerate(
            (view("stopped"), view("running"), view("fault", fault="E-3"), view("fault", fault="E-3"))
        ):
            store.on_view(status, float(n), NOON_MS)
        stored = await _flushed_documents(historian)
        assert (stored["fan-1"]["starts"], stored["fan-1"]["faults"]) == (1, {"E-3": 1})


async def _flushed_documents(historian: Historian) -> dict[str, Any]:
    await historian.flush()
    return await historian.documents(DOCUMENT_KIND)


def test_stored_statistics_are_loaded_later_and_never_overwritten_before() -> None:
    class UnavailableHistorian:
        is_down = True
        stored: dict[str, Any] = {"fan-1": {"running_s": 7.0, "turned": True}}

        def put_document(self, kind: str, id: str, value: Any) -> None:
            self.stored[id] = value

        async def documents(self, kind: str) -> dict[str, Any]:
            if self.is_down:
                raise ServiceUnavailable("history.unavailable", why="away")
            return dict(self.stored)

    async def scenario() -> None:
        fake = UnavailableHistorian()
        store = RunStatisticsStore(fake)
        await store.open()
        for n in range(200):
            store.on_view(view("running"), float(n), NOON_MS)
        assert fake.stored["fan-1"]["running_s"] == 7.0
        fake.is_down = False
        await asyncio.sleep(LOAD_RETRY_S + 0.1)
        for n in range(3):
            store.on_view(view("running"), 200.0 + n, NOON_MS)
        await store.close()
        assert fake.stored["fan-1"]["running_s"] == 9.0

    virtual_time.run(scenario())


DAMAGED = [
    '{"starts": "two"}',
    '{"starts": true}',
    '{"running_s": NaN}',
    '{"running_s": 1e999}',
    '{"energy_kwh": ' + "9" * 400 + "}",
    '{"faults": ["E-3"]}',
    '{"faults": {"E-3": null}}',
    '{"faults": null}',
    '{"faults": {"E-3": ' + "9" * 400 + "}}",
    '{"turned": "yes"}',
    '{"starts": ' + "9" * 5_000 + "}",
    '{"turned": 1}',
    '{"fault": 3}',
    "[]",
    "5",
    "{",
    "",
    "[" * 100_000,
]


@pytest.mark.parametrize("damaged", DAMAGED, ids=[text[:30] for text in DAMAGED])
async def test_damaged_statistics_of_one_drive_are_kept_aside_and_it_is_counted_again(
    database: HistoryDatabase, damaged: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing was counted any more, of any drive, without an alarm."""
    async with database.historian() as historian:
        historian.queue.put_document(Document(DOCUMENT_KIND, "fan-1", damaged))
        historian.put_document(DOCUMENT_KIND, "fan-2", {"starts": 7})
    async with database.historian() as historian:
        store = RunStatisticsStore(historian)
        await store.open()
        for n, state in enumerate(("stopped", "running")):
            store.on_view(view(state), float(n), NOON_MS)
        assert (store.statistics_json("fan-1")["starts"], store.statistics_json("fan-2")["starts"]) == (1, 7)
        await store.close()
        assert (await _flushed_documents(historian))["fan-1"]["starts"] == 1
        (kept,) = (await historian.documents(store.damaged_copy)).values()
    assert kept == damaged or kept == json.loads(damaged)
    (record,) = [log_record.message for log_record in caplog.records if "run statistics" in log_record.message]
    assert "fan-1" in record and store.damaged_copy in record
