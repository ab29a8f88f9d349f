"""Prometheus metrics: the current state, without values that are not known now."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from prometheus_client import parser
from prometheus_client.openmetrics import parser as openmetrics

from drivebus.errors import ServiceUnavailable
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import ROLE_RIGHTS, Role
from drivebus.service.config.model import BusConfig
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.web.metrics import (
    METRIC_PREFIX,
    METRICS,
    SIGNAL_METRICS,
    ScrapeData,
    exposition,
    fetch_scrape_data,
    metric_points,
)
from fixtures.running_service import http_service, real_service, token
from fixtures.service import DRIVES, ServiceKit, plant_config, running_service
from fixtures.web_app import WebAppHarness

Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]
VIEWER = Actor("scraper", ROLE_RIGHTS[Role.VIEWER], "token-1", remote=True)
LABELS = {
    "gateway",
    "plant",
    "version",
    "priority",
    "bus",
    "error",
    "kind",
    "quantile",
    "drive",
    "address",
    "model",
    "presence",
    "state",
    "signal",
}


def series(data: ScrapeData) -> Series:
    """Return the series as a scraper reads them."""
    body, media_type = exposition(metric_points(data), "text/plain")
    assert media_type.startswith("text/plain; version=")
    return parsed(body.decode())


def parsed(body: str) -> Series:
    found: Series = {}
    for family in parser.text_string_to_metric_families(body):
        assert family.documentation == METRICS[bare(family)].text("en")
        for sample in family.samples:
            key = sample.name, tuple(sorted(sample.labels.items()))
            assert key not in found, key
            found[key] = sample.value
    return found


def bare(family: Any) -> str:
    name: str = family.name.removeprefix(METRIC_PREFIX)
    return name + "_total" if family.type == "counter" else name


def of(found: Series, name: str, **labels: str) -> float | None:
    """Return one value; None where the series is absent."""
    return found.get((METRIC_PREFIX + name, tuple(sorted(labels.items()))))


class ServiceWithAlarms:
    """The service, with the active alarms that the fixture has without an alarm log on disk."""

    def __init__(self, kit: ServiceKit) -> None:
        self.service = kit.service

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        if operation == "alarms.list":
            return self.service.plant.alarms.as_json()
        return await self.service.call(operation, params, actor)


async def scraped(kit: ServiceKit) -> tuple[Series, ScrapeData]:
    service: Any = ServiceWithAlarms(kit)
    data = await fetch_scrape_data(service, VIEWER)
    return series(data), data


def test_a_scrape_shows_the_plants_state_without_bus_requests() -> None:

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            await kit.call("drive.stop", drive="pump-1")
            await asyncio.sleep(6)
            sent = await requests(kit)
            found, message = await scraped(kit)
            assert await requests(kit) == sent
            drives = {drive["id"]: drive for drive in message.drives}
            for id, drive in drives.items():
                signals = drive["signals"]
                assert of(found, "drive_up", drive=id) == 1
                assert of(found, "drive_state", drive=id, state=drive["state"]) == 1
                assert (
                    of(found, "drive_state_age_seconds", drive=id) == (drive["time_ms"] - drive["state_time_ms"]) / 1000
                )
                assert of(found, "drive_fault_code", drive=id) == 0
                good = [metric for metric in SIGNAL_METRICS if signals.get(metric.signal, {}).get("quality") == "good"]
                assert "output_frequency" in {metric.signal for metric in good}
                for metric in good:
                    assert of(found, metric.metric, drive=id) == signals[metric.signal]["value"] * metric.factor
            assert of(found, "drive_output_frequency_hertz", drive="fan-1") == 20.0
            assert of(found, "drive_commanded_frequency_hertz", drive="fan-1") == 20.0
            assert of(found, "drive_commanded_frequency_hertz", drive="pump-1") is None
            assert of(found, "drive_state", drive="fan-1", state="running") == 1
            assert of(found, "drive_state", drive="fan-1", state="stopped") == 0
            assert (
                of(found, "drive_controlled", drive="fan-1") == 1 and of(found, "drive_controlled", drive="fan-2") == 0
            )
            assert of(found, "drive_info", drive="fan-1", bus="a", address="1", model="c320") == 1
            assert of(found, "stop_requests_total") == of(found, "stops_confirmed_total") == 1
            for bus in message.buses:
                id = bus["id"]
                assert of(found, "bus_up", bus=id) == 1
                assert of(found, "bus_requests_total", bus=id) == bus["transactions"] > 100
                assert of(found, "bus_replies_total", bus=id) == bus["replies"] > 100
                assert of(found, "bus_load_ratio", bus=id) == bus["load_percent"] / 100 > 0.01
                assert of(found, "bus_reply_seconds", bus=id, quantile="0.95") == bus["reply_p95_s"]
                assert of(found, "bus_cycle_seconds", bus=id) == max(
                    station["refresh_s"] for station in bus["stations"]
                )

    run(scenario())


async def requests(kit: ServiceKit) -> list[int]:
    return [line.bus.statistics().transactions for line in kit.service.plant.buses.values()]


def test_a_drive_that_stops_answering_loses_its_values() -> None:
    """The values are removed within 3 poll periods and a timeout."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            found, _ = await scraped(kit)
            assert of(found, "drive_output_frequency_hertz", drive="fan-1") == 0.0
            assert of(found, "drive_fault_code", drive="fan-1") == 0
            kit.station("fan-1").faults.silent = True
            await asyncio.sleep(20)
            found, _ = await scraped(kit)
            measured = {METRIC_PREFIX + signal.metric for signal in SIGNAL_METRICS} | {
                METRIC_PREFIX + "drive_fault_code"
            }
            assert not [key for key in found if key[0] in measured and ("drive", "fan-1") in key[1]]
            assert [key for key in found if key[0] in measured and ("drive", "fan-2") in key[1]]
            assert of(found, "drive_up", drive="fan-1") == 0
            assert of(found, "drive_presence", drive="fan-1", presence="offline") == 1
            assert of(found, "drive_state", drive="fan-1", state="unknown") == 1
            assert of(found, "drive_state", drive="fan-1", state="stopped") == 0
            assert of(found, "drive_signal_valid", drive="fan-1", signal="output_frequency") == 0
            age_s = of(found, "drive_signal_age_seconds", drive="fan-1", signal="output_frequency")
            assert age_s is not None and age_s > 19.0
            assert of(found, "drive_errors_total", drive="fan-1", error="NoReply")
            assert of(found, "bus_errors_total", bus="a", error="NoReply")
            assert of(found, "drive_alarms_active", drive="fan-1", priority="high") == 1
            assert of(found, "alarms_active", priority="high") == of(found, "alarms_unacknowledged", priority="high")

    run(scenario())


def test_an_alarm_that_has_cleared_is_no_longer_counted_as_active_and_still_waits_for_its_acknowledgement() -> None:
    """Regression: a fault that was reset was counted as active until a user acknowledged it."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            for silent, active, cleared in ((True, 1, 0), (False, 0, 1)):
                kit.station("fan-1").faults.silent = silent
                await asyncio.sleep(20 if silent else 90)
                found, _ = await scraped(kit)
                for prefix, labels in (("", {}), ("drive_", {"drive": "fan-1"})):
                    counts = [
                        of(found, f"{prefix}alarms_{state}", priority="high", **labels)
                        for state in ("active", "cleared_unacknowledged")
                    ]
                    assert counts == [active, cleared]
                assert of(found, "alarms_unacknowledged", priority="high") == 1
            (alarm,) = (await kit.call("alarms.list"))["active"]
            await kit.call("alarm.acknowledge", alarm=alarm["id"])
            found, _ = await scraped(kit)
            assert of(found, "alarms_cleared_unacknowledged", priority="high") == 0

    run(scenario())


@pytest.mark.parametrize("reading", [{"quality": "uncertain"}, {"quality": "bad", "value": None}, {"unit": ""}])
def test_an_uncertain_reading_or_one_of_unknown_scale_is_not_a_metric(reading: Json) -> None:
    """DZB100's scale is uncertain by a factor of ten; a raw word is not a current."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            _, message = await scraped(kit)
            pump = next(drive for drive in message.drives if drive["id"] == "pump-1")
            pump["signals"]["output_current"] |= reading
            found = series(message)
            assert of(found, "drive_output_current_amperes", drive="pump-1") is None
            assert of(found, "drive_output_current_amperes", drive="pump-2") is not None
            good = of(found, "drive_signal_valid", drive="pump-1", signal="output_current")
            assert good == float("quality" not in reading)

    run(scenario())


def test_a_port_that_cannot_be_opened_has_no_load_and_no_reply_times() -> None:
    async def scenario() -> None:
        buses = (BusConfig("a", "sim://c320@1,2"), BusConfig("b", "/dev/no-such-port"))
        async with running_service(plant_config(buses=buses)) as kit:
            await asyncio.sleep(5)
            found, _ = await scraped(kit)
            assert of(found, "bus_up", bus="b") == 0
            message = {key[0] for key in found if ("bus", "b") in key[1]}
            assert not message & {
                METRIC_PREFIX + name for name in ("bus_load_ratio", "bus_occupied_ratio", "bus_reply_seconds")
            }
            assert of(found, "bus_load_ratio", bus="a") and of(found, "bus_reply_seconds", bus="a", quantile="0.5")
            assert of(found, "alarms_active", priority="critical") == 1

    run(scenario())


def test_a_drive_without_a_state_has_no_fault_metric() -> None:
    """DF800: its stop is acknowledged and never confirmed."""

    async def scenario() -> None:
        drives = (replace(DRIVES[0], model="df800"),)
        async with running_service(
            plant_config(buses=(BusConfig("a", "sim://df800@1"),), drives=drives, groups=())
        ) as kit:
            await asyncio.sleep(5)
            await kit.call("drive.stop", drive="fan-1")
            found, _ = await scraped(kit)
            assert of(found, "drive_up", drive="fan-1") == 1 and of(found, "drive_fault_code", drive="fan-1") is None
            assert of(found, "stops_acknowledged_total") == 1 and of(found, "stops_confirmed_total") == 0

    run(scenario())


TRIPPED: Json = {
    "running_h": 1.5,
    "starts": 3,
    "energy_kwh": 2.0,
    "maximum_current_a": None,
    "faults": {"7": 2, "9": 1},
}
ALARM: Json = {
    "drive": "fan-1",
    "priority": "low",
    "cleared_ms": None,
    "acknowledged_ms": None,
    "shelved_until_ms": None,
}


async def test_every_metric_of_the_table_is_scraped_and_every_label_is_bounded(tmp_path: Path) -> None:
    """The whole plant runs with its history on disk; the test adds the values that these drives do not report."""
    async with real_service(tmp_path) as kit:
        for _ in range(1000):
            message = await fetch_scrape_data(kit.service, VIEWER)
            if all(drive["state"] != "unknown" for drive in message.drives) and message.plant["disk"]:
                break
            await asyncio.sleep(0.05)
        fan = message.drives[0]
        fan["commanded_hz"] = 5.0
        for metric in SIGNAL_METRICS:
            fan["signals"][metric.signal] = {"value": 1.5, "unit": metric.unit, "quality": "good", "source_time_ms": 1}
        message.plant["gateways"] = [
            {"id": "web", "running": True, "pid": 9, "starts": 2, "exit_code": -9},
            {"id": "toy", "running": False, "pid": None, "starts": 1, "exit_code": 1},
        ]
        message.statistics["drives"]["fan-1"] = TRIPPED
        message.buses[0]["errors"]["NoReply"] = message.buses[0]["stations"][0]["errors"]["NoReply"] = 1
        message.alarms[:] = [
            ALARM,
            ALARM | {"acknowledged_ms": 1},
            ALARM | {"shelved_until_ms": 9},
            ALARM | {"cleared_ms": 1},
            ALARM | {"cleared_ms": 1, "shelved_until_ms": 9},
        ]
        found = series(message)
    assert {name.removeprefix(METRIC_PREFIX) for name, _ in found} == METRICS.keys()
    assert {name for _, labels in found for name, _ in labels} == LABELS
    assert of(found, "drive_running_seconds_total", drive="fan-1") == 5400.0
    assert of(found, "drive_trips_total", drive="fan-1") == 3
    assert of(found, "drive_energy_joules", drive="fan-1") == 7.2e6
    assert of(found, "drive_output_power_watts", drive="fan-1") == 1500.0
    assert (of(found, "alarms_active", priority="low"), of(found, "alarms_shelved")) == (2, 2)
    assert of(found, "alarms_cleared_unacknowledged", priority="low") == 1
    assert of(found, "alarms_unacknowledged", priority="low") == 2
    assert of(found, "drive_alarms_cleared_unacknowledged", drive="fan-1", priority="low") == 1
    assert of(found, "drive_alarms_cleared_unacknowledged", drive="fan-2", priority="low") == 0
    assert (of(found, "gateway_up", gateway="web"), of(found, "gateway_up", gateway="toy")) == (1, 0)
    assert of(found, "gateway_starts_total", gateway="web") == 2
    assert of(found, "disk_size_bytes") == message.plant["disk"]["total_mb"] * 2**20


def test_metric_names_follow_the_conventions() -> None:
    units = ("hertz", "amperes", "volts", "watts", "celsius", "seconds", "joules", "bytes", "ratio")
    foreign = ("_hz", "_percent", "_ms", "_s", "_a", "_v", "_kw", "_kwh", "_h", "_mb")
    assert not [name for name in METRICS if name.endswith(foreign)]
    assert {signal.metric.rpartition("_")[2] for signal in SIGNAL_METRICS} <= set(units)
    assert {metric.kind for metric in METRICS.values() if metric.name.endswith("_total")} == {"counter"}


@pytest.mark.parametrize("suffix", ["", ".zh"])
def test_every_metric_is_documented(suffix: str) -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / f"metrics{suffix}.md"
    message = page.read_text(encoding="utf-8")
    language = "zh" if suffix else "en"
    rows = {name: f"| `{METRIC_PREFIX}{name}` | " for name in METRICS}
    missing = [name for name, row in rows.items() if row not in message or METRICS[name].text(language) not in message]
    assert missing == []
    assert not [name for name in METRICS if METRICS[name].text(language).startswith("metrics.")]


def test_the_alert_rules_name_metrics_and_labels_that_exist() -> None:
    """Prometheus itself accepts a rule of an unknown metric, which never calls anybody."""
    rules = Path(__file__).parents[2] / "examples" / "prometheus" / "drivebus.rules.yml"
    text = rules.read_text(encoding="utf-8")
    named = set(re.findall(rf"\b{METRIC_PREFIX}(\w+)", text))
    assert len(named) >= 4 and named <= METRICS.keys()
    for name, labels in re.findall(rf"\b{METRIC_PREFIX}(\w+)\{{(\w+)", text):
        assert labels in METRICS[name].labels, name
    shown = set(re.findall(r"\$labels\.(\w+)", text))
    assert shown <= {"instance"} | {label for name in named for label in METRICS[name].labels}


class UnavailableService:
    """A plant that does not answer."""

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        raise ServiceUnavailable("plant.stopping")

    async def record(self, entry: Json, actor: Actor) -> None:
        return

    async def end_control(self, reason: str, actor: Actor) -> None:
        return


async def test_a_plant_that_does_not_answer_fails_the_scrape(tmp_path: Path) -> None:
    gone: Any = UnavailableService()
    harness = WebAppHarness(tmp_path, service=gone)
    client = await harness.log_in("viewer")
    answer = await client.get("/metrics")
    assert (answer.status_code, answer.json()["error"]["kind"]) == (503, "ServiceUnavailable")
    await client.aclose()


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    def same(kit: ServiceKit) -> ServiceClient:
        return kit.service

    with http_service(tmp_path_factory.mktemp("plant"), same) as found:
        yield found.url


@pytest.mark.parametrize("accept", ["text/plain;version=0.0.4", "application/openmetrics-text;version=1.0.0"])
def test_a_scrape_requires_at_least_a_viewers_token(address: str, accept: str) -> None:
    headers = {"Authorization": f"Bearer {token(Role.VIEWER)}", "Accept": accept}
    answer = httpx.get(f"{address}/metrics", headers=headers)
    assert answer.status_code == 200 and answer.headers["cache-control"] == "no-store"
    assert answer.headers["content-type"].startswith(accept.partition(";")[0])
    read = openmetrics if "openmetrics" in accept else parser
    families = [*read.text_string_to_metric_families(answer.text)]
    assert {bare(family) for family in families} == METRICS.keys()
    assert httpx.get(f"{address}/metrics").status_code == 401
    assert httpx.post(f"{address}/metrics", headers=headers).status_code == 405
