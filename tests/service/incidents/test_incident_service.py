"""Incidents and alarms of a running service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from drivebus.capture.dbcap import CaptureHeader, read_capture
from drivebus.drives import MemoryStore
from drivebus.errors import NotFound
from drivebus.serial_settings import SerialSettings
from drivebus.service.alarms import AlarmChange
from drivebus.service.alarms.log import AlarmLog
from drivebus.service.api.errors import localized
from drivebus.service.app import Service
from drivebus.service.config.load import load
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig
from drivebus.service.incidents import IncidentStore
from drivebus.service.incidents.store import MAX_NOTES
from drivebus.service.runtime.plant import Plant, PlantListener
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import clear_simulated_buses
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import (
    BUSES,
    DRIVES,
    FakeAuditTrail,
    FakeHistory,
    ServiceKit,
    fake_storage,
    plant_config,
    remote_actor,
    running_service,
)


@asynccontextmanager
async def service_with_logs(folder: Path, plant: PlantConfig | None = None) -> AsyncIterator[ServiceKit]:
    log = AlarmLog(folder / "alarms.jsonl")
    trail, history = FakeAuditTrail(), FakeHistory()
    storage = fake_storage(trail, history, alarm_log=log, incidents=IncidentStore(folder / "incidents"))
    try:
        async with Service(plant or plant_config(), storage) as service:
            yield ServiceKit(service, trail, history, MemoryStore(), storage)
        await log.close()
    finally:
        clear_simulated_buses()


async def trip(kit: ServiceKit) -> dict[str, Any]:
    await asyncio.sleep(5)
    await kit.grant_waivers("fan-1")
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
    await asyncio.sleep(20)
    kit.station("fan-1").trip(Trip.UNDERVOLTAGE)
    await asyncio.sleep(4)
    (alarm,) = await faults(kit)
    return alarm


async def faults(kit: ServiceKit) -> list[dict[str, Any]]:
    return [item for item in (await kit.call("alarms.list"))["active"] if item["kind"] == "fault"]


def test_the_event_of_a_fault_has_its_label_once() -> None:
    """The text of a C320's fault has its label, that of a DZB100 has not."""

    async def scenario() -> None:
        saw = DriveConfig(id="saw", bus="c", address=1, model="dzb100", title=Text("Saw", "锯"))
        config = plant_config(buses=(*BUSES, BusConfig("c", "sim://dzb100@1")), drives=(*DRIVES, saw))
        async with running_service(config) as kit:
            await asyncio.sleep(5)
            assert kit.event_texts("fault") == []
            for drive in ("fan-1", "saw"):
                kit.station(drive).trip(Trip.OVERHEAT)
            await asyncio.sleep(4)
            found = {drive: (await kit.call("drives.get", drive=drive))["fault"] for drive in ("fan-1", "saw")}
            [with_label, other] = found.values()
            assert with_label["label"] in with_label["text"]["en"] and other["label"] not in other["text"]["en"]
            assert sorted(kit.event_texts("fault")) == sorted(
                [
                    i18n.text("plant.drive_fault_says", "en", fault=with_label["text"]["en"]),
                    i18n.text("plant.drive_fault", "en", label=other["label"], fault=other["text"]["en"]),
                ]
            )

    run(scenario())


def test_a_trip_raises_an_alarm_with_an_incident_of_the_minute_before(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            alarm = await trip(kit)
            assert (alarm["drive"], alarm["priority"], alarm["value"]) == ("fan-1", "critical", 5)
            outcomes = [
                item["outcome"]
                for item in kit.history.events
                if item["kind"] == "alarm" and "fault" in item["text"]["en"]
            ]
            assert outcomes == ["raised"], "the incident attached later is no further event"
            (listed,) = (await kit.call("incidents.list"))["items"]
            assert listed["id"] == alarm["incident"] == "000001-fan-1"
            incident = await kit.call("incidents.get", incident=alarm["incident"])
            assert incident["view"]["fault"]["code"] == 5 and incident["view"]["state"] == "fault"
            states = [item["state"] for item in incident["states"]]
            assert states[-1] == "fault" and "running" in states
            frequencies = incident["signals"]["output_frequency"]
            assert max(value or 0.0 for value in frequencies["v"]) == 20.0
            assert len(frequencies["t"]) > 20 and frequencies["t"][-1] <= 0.0
            assert 20 < len(incident["frames"]) <= 200
            assert [item["text"]["en"] for item in incident["events"] if item["kind"] == "command"]
            assert {"F0.1", "F9.3", "F9.4"} <= incident["parameters"].keys()
            assert incident["parameters"]["F0.1"]["text"]["en"]
            shown = await kit.call("parameters.read", drive="fan-1", names=["F9.4"])
            assert incident["parameters"]["F9.4"] == shown["parameters"]["F9.4"], "the drive's page shows the same"
            assert shown["parameters"]["F9.4"]["reason"] == "drives.item_not_echoed", "not a rejection: 0 in a fault"
            (tmp_path / "x.dbcap").write_text(incident["capture"]["text"])
            assert len(read_capture(tmp_path / "x.dbcap").records) > 20

    run(scenario())


@pytest.mark.parametrize("named_at", ["raised", "incident"], ids=["before it is saved", "afterwards"])
def test_an_incident_has_the_name_of_a_fault_that_is_named_after_its_trip(tmp_path: Path, named_at: str) -> None:
    """On a full bus the list of incidents had "a fault whose code is not known" for ever."""

    class Naming(PlantListener):
        def __init__(self, plant: Plant) -> None:
            self._plant = plant

        def on_alarm(self, change: AlarmChange) -> None:
            if change.action == named_at and change.alarm.kind == "fault":
                named = replace(change.alarm, text=Text("overheated", "过热"))
                self._plant.alarms._alarms[named.id] = named
                asyncio.get_running_loop().call_soon(self._plant.publish_alarms, [AlarmChange("named", named)])

    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            kit.service.plant.subscribe(Naming(kit.service.plant))
            await trip(kit)
            await asyncio.sleep(5)
            (listed,) = (await kit.call("incidents.list"))["items"]
            incident = await kit.call("incidents.get", incident=listed["id"])
            assert [found["text"]["en"] for found in (listed, incident)] == ["overheated"] * 2
            assert kit.drives_of_events("plant.alarm_named", text=Text("overheated", "过热")) == ["fan-1"]

    run(scenario())


def test_a_trip_on_a_slow_bus_is_one_event_one_alarm_and_one_incident_with_its_code(tmp_path: Path) -> None:
    """Each word is read every 15 s and counts only when it was read twice: the fault word came 12 s after the state."""
    slow = DriveConfig(id="fan-1", bus="a", address=1, model="eds300", min_poll_interval_s=15.0)
    plant = plant_config(buses=(BusConfig("a", "sim://eds300@1"),), drives=(slow,), groups=())

    async def scenario() -> None:
        async with service_with_logs(tmp_path, plant) as kit:
            for pause_s in (60, 7, 11):
                await asyncio.sleep(pause_s)
                before = len(kit.history.events)
                kit.station("fan-1").trip(Trip.UNDERVOLTAGE)
                await asyncio.sleep(16)
                (alarm,) = await faults(kit)
                news = kit.history.events[before:]
                found = [
                    event["text"]["en"]
                    for event in news
                    if event["kind"] in ("fault", "alarm") and event["outcome"] != "cleared"
                ]
                assert found == ["alarm E5, see the alarm table of the manual", alarm["text"]["en"]]
                incident = (await kit.call("incidents.list"))["items"][0]
                assert (alarm["value"], incident["text"]) == (5, alarm["text"])
                kit.station("fan-1").motor.reset()
                await asyncio.sleep(40)
                await kit.call("alarm.acknowledge", alarm=alarm["id"])

    run(scenario())


def test_a_trip_that_repeats_unacknowledged_is_one_alarm_whose_occurrences_keep_their_incidents(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            first = await trip(kit)
            for _ in range(2):
                kit.station("fan-1").motor.reset()
                await asyncio.sleep(15)
                kit.station("fan-1").trip(Trip.UNDERVOLTAGE)
                await asyncio.sleep(15)
            (alarm,) = await faults(kit)
            assert (alarm["count"], alarm["first_id"], alarm["first_raised_ms"]) == (3, first["id"], first["raised_ms"])
            text = Text.from_mapping(alarm["text"])
            for count, times in ((2, 1), (3, 1), (1, 0)):
                assert kit.drives_of_events("plant.alarm_raised_again", text=text, count=count) == ["fan-1"] * times
            await kit.call("alarm.acknowledge", remote_actor(), alarm=first["id"])
            history = (await kit.call("alarms.history", drive="fan-1"))["items"]
            found = [alarm for alarm in history if alarm["kind"] == "fault"]
            assert [fault["acknowledged_by"] for fault in found] == ["ann"] * 3
            incidents = [await kit.call("incidents.get", incident=fault["incident"]) for fault in found]
            assert [incident["raised"]["raised_ms"] for incident in incidents] == [
                fault["raised_ms"] for fault in found
            ]
            assert len({incident["id"] for incident in incidents}) == 3

    run(scenario())


def test_acknowledged_and_shelved_alarms_are_in_the_log_after_a_restart(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            alarm = await trip(kit)
            found = await kit.call("alarm.shelve", remote_actor(), alarm=alarm["id"], minutes=5, reason="known trouble")
            assert found["shelved_until_ms"] > alarm["raised_ms"]
            await kit.call("alarm.unshelve", remote_actor(), alarm=alarm["id"])
            await kit.call("alarm.acknowledge", remote_actor(), alarm=alarm["id"])
            with pytest.raises(NotFound):
                await kit.call("alarm.acknowledge", remote_actor(), alarm="a99")
            assert kit.trail.outcomes("alarm.acknowledge") == ["requested", "done", "requested", "alarms.unknown"]
            expected = (
                ("plant.alarm_raised", None),
                ("plant.alarm_shelved", "ann"),
                ("plant.alarm_unshelved", None),
                ("plant.alarm_acknowledged", "ann"),
            )
            text = Text.from_mapping(alarm["text"])
            about = [
                event for event in kit.history.events if event["kind"] == "alarm" and text.zh in event["text"]["zh"]
            ]
            assert [(event["text"], event["actor"]) for event in about] == [
                (localized(key, {"text": text}), actor) for key, actor in expected
            ]
        async with service_with_logs(tmp_path) as kit:
            (again,) = await faults(kit)
            assert (again["id"], again["acknowledged_by"], again["incident"]) == (alarm["id"], "ann", alarm["incident"])
            assert kit.drives_of_events("plant.alarm_cleared", text=text) == []
            await asyncio.sleep(5)
            assert await faults(kit) == []
            assert kit.drives_of_events("plant.alarm_cleared", text=text) == ["fan-1"]
            logged = [
                item for item in (await kit.call("alarms.history", drive="fan-1"))["items"] if item["kind"] == "fault"
            ]
            assert [(item["id"], item["cleared_ms"] is None) for item in logged] == [(alarm["id"], False)]
            assert (await kit.call("alarms.history", drive="fan-2"))["items"] == []
            with pytest.raises(NotFound):
                await kit.call("incidents.get", incident="000009-fan-1")

    run(scenario())


def test_a_note_on_an_incident_keeps_its_author_and_time_over_a_restart(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            id = (await trip(kit))["incident"]
            assert (await kit.call("incidents.get", incident=id))["notes"] == []
            await kit.call("incident.note", remote_actor(), incident=id, note="bearing seized")
            found = await kit.call("incident.note", incident=id, note="bearing exchanged")
            assert [(note["by"], note["text"]) for note in found["notes"]] == [
                ("ann", "bearing seized"),
                ("tester", "bearing exchanged"),
            ]
            assert kit.trail.outcomes("incident.note") == ["requested", "done", "requested", "done"]
            with pytest.raises(NotFound):
                await kit.call("incident.note", incident="000009-fan-1", note="nothing here")
        async with service_with_logs(tmp_path) as kit:
            assert (await kit.call("incidents.get", incident=id))["notes"] == found["notes"]

    run(scenario())


def test_the_notes_of_an_incident_are_bounded(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path)
    id = store.write("fan-1", {"time_ms": 0, "drive": "fan-1"}, {}, CaptureHeader(SerialSettings(), "", "", ""), [])
    for n in range(MAX_NOTES + 1):
        store.add_note(id, {"text": str(n)})
    notes = store.get(id)["notes"]
    assert (len(notes), notes[0]["text"], notes[-1]["text"]) == (MAX_NOTES, "1", str(MAX_NOTES))


def test_a_failing_incident_store_is_an_alarm_until_it_works_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with service_with_logs(tmp_path) as kit:
            (tmp_path / "incidents").write_text("a file where the folder should be")
            alarm = await trip(kit)
            await asyncio.sleep(6)
            (store,) = [item for item in (await kit.call("alarms.list"))["active"] if item["kind"] == "storage_failure"]
            assert (store["subject"], store["cleared_ms"], alarm["incident"]) == ("incidents", None, None)
            await kit.call("alarm.shelve", alarm=alarm["id"], minutes=1, reason="to be looked at")
            (tmp_path / "incidents").unlink()
            await asyncio.sleep(20)
            (saved,) = (await kit.call("incidents.list"))["items"]
            assert (saved["drive"], saved["alarm"]) == ("fan-1", alarm["id"]), "a shelf is no trip"
            assert kit.service.plant.alarms.find(alarm["id"]).incident == saved["id"]  # type: ignore[union-attr]
            (store,) = [item for item in (await kit.call("alarms.list"))["active"] if item["kind"] == "storage_failure"]
            assert store["cleared_ms"] is not None

    run(scenario())


@pytest.mark.parametrize("change", ["address", "bus", "model"])
def test_an_incident_after_a_reload_that_replaced_the_motor_has_nothing_of_the_former_one(
    tmp_path: Path, change: str
) -> None:
    """It had the minute before of the former motor, and a trip within ten seconds was part of its incident."""
    head = (
        'format = 1\n[plant]\nid = "p"\n'
        '[bus.a]\nport = "sim://c320@1-3?ramp=2&name=a"\n[bus.b]\nport = "sim://c320@1-3?ramp=2&name=b"\n'
    )
    before = {"bus": "a", "address": 1, "model": "c320"}
    after = before | {"address": {"address": 2}, "bus": {"bus": "b"}, "model": {"model": "c300"}}[change]

    def write(drive: dict[str, Any]) -> PlantConfig:
        drive_text = "".join(f"{name} = {value!r}\n" for name, value in drive.items())
        (tmp_path / "plant.toml").write_text(f"{head}[drive.fan-1]\n{drive_text}".replace("'", '"'))
        return load(tmp_path / "plant.toml")

    async def scenario() -> None:
        async with service_with_logs(tmp_path, write(before)) as kit:
            first = await trip(kit)
            write(after)
            await kit.call("configuration.reload")
            assert [fault["cleared_ms"] is None for fault in await faults(kit)] == [False], (
                "another motor has no fault yet"
            )
            replaced_at = kit.service.plant.now()
            await asyncio.sleep(3)
            kit.station("fan-1").trip(Trip.UNDERVOLTAGE)
            await asyncio.sleep(3)
            second = next(alarm for alarm in await faults(kit) if alarm["id"] != first["id"])
            assert second["incident"] != first["incident"]
            incident = await kit.call("incidents.get", incident=second["incident"])
            since_s = -(kit.service.plant.now() - replaced_at)
            times_s = [t for series in incident["signals"].values() for t in series["t"]]
            assert times_s and min(times_s) >= since_s
            assert "running" not in [item["state"] for item in incident["states"]]
            assert not [item for item in incident["events"] if item["kind"] == "command"]
            own = [frame["t"] for frame in incident["frames"] if frame["station"] == after["address"]]
            assert own and min(own) >= since_s

    run(scenario())
