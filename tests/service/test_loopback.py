"""Loop-back test of a service: one read of its bus at a time, bounded in number and time, and never before a stop."""

from __future__ import annotations

import asyncio

import pytest

from drivebus import i18n
from drivebus.errors import CapabilityError, InvalidParameters, NoReply, ServiceUnavailable
from drivebus.protocols.modbus import Diagnostics
from drivebus.service.api.operations.drives import LOOPBACK_TEST, LOOPBACK_TIMEOUT_S
from drivebus.service.config.model import BusConfig
from drivebus.service.one_at_a_time import MAX_WAITING
from drivebus.testing.virtual_time import run
from fixtures.service import BUSES, ServiceKit, plant_config, ready, running_service


def last_loopback(kit: ServiceKit) -> int:
    """Return the number of the bus's last frame that is a loop-back, 0 where there is none."""
    frames = kit.service.plant.buses["b"].frames
    return max((frame.number for frame in frames if isinstance(frame.event.message, Diagnostics)), default=0)


def test_loopbacks_are_counted_in_both_languages() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            found = await kit.call("loopback.test", drive="pump-1", count=20)
            assert (found["requests"], found["repetitions"], found["error"]) == (20, 0, None)
            assert found["complete"] and len(found["round_trips_ms"]) == 20 and min(found["round_trips_ms"]) > 0
            for language in ("en", "zh"):
                sentence = i18n.text("loopback.returned", language, returned=20, requests=20)
                assert found["text"][language].startswith(sentence)
            assert not kit.trail.entries, "it changes nothing"

    run(scenario())


def test_a_model_without_loopback_more_than_the_bound_and_a_silent_drive_are_refused() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            with pytest.raises(CapabilityError):
                await kit.call("loopback.test", drive="fan-1")
            for count in (0, 101):
                with pytest.raises(InvalidParameters):
                    await kit.call("loopback.test", drive="pump-1", count=count)
            kit.station("pump-1").faults.silent = True
            with pytest.raises(NoReply):
                await kit.call("loopback.test", drive="pump-1", count=100)

    run(scenario())


def test_the_profile_says_whether_a_model_has_a_loopback() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            found = {model: await kit.call("models.get", model=model) for model in ("vc660", "df800", "c320", "gd20")}
            assert [model for model, profile in found.items() if profile["has_loopback"]] == ["vc660", "gd20"]

    run(scenario())


def test_loopbacks_are_sent_in_the_queue_of_reads() -> None:
    """Beside the queue of their bus they would go before the reads that confirm a stop."""

    async def scenario() -> None:
        async with running_service() as kit:
            names = [*kit.service.plant.drives["pump-1"].profile.parameters][:64]
            read = asyncio.create_task(kit.call("parameters.read", drive="pump-1", names=names))
            await asyncio.sleep(0.1)
            tests = [
                asyncio.create_task(kit.call("loopback.test", drive="pump-2", count=5)) for _ in range(MAX_WAITING // 2)
            ]
            await asyncio.sleep(0.1)
            before = last_loopback(kit)
            with pytest.raises(ServiceUnavailable) as refused:
                await kit.call("loopback.test", drive="pump-2")
            assert refused.value.key == "plant.too_busy"
            assert not read.done() and not any(test.done() for test in tests)
            await asyncio.gather(read, *tests)
            assert last_loopback(kit) > before

    run(scenario())


def test_the_time_limit_ends_a_test_on_a_slow_bus() -> None:
    """Other reads of the bus would wait for a hundred loop-backs at 1,200 baud for more than twenty seconds."""

    async def scenario() -> None:
        slow = BusConfig("b", BUSES[1].port, baud=1200)
        async with running_service(plant_config(buses=(BUSES[0], slow))) as kit:
            await asyncio.sleep(5)
            loop = asyncio.get_running_loop()
            began_at = loop.time()
            found = await kit.call("loopback.test", drive="pump-1", count=100)
            assert LOOPBACK_TIMEOUT_S <= loop.time() - began_at < LOOPBACK_TIMEOUT_S + 1
            assert not found["complete"] and found["requests"] == len(found["round_trips_ms"]) < 100
            for language in ("en", "zh"):
                sentence = i18n.text("loopback.time_limit", language, seconds=LOOPBACK_TIMEOUT_S)
                assert found["text"][language].endswith(sentence)

    run(scenario())


def test_a_test_whose_client_has_gone_sends_nothing_more() -> None:
    assert LOOPBACK_TEST.cancellable, "socket and web cancel the call of a client that disconnects"

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            test = asyncio.create_task(kit.call("loopback.test", drive="pump-1", count=100))
            await asyncio.sleep(0.5)
            test.cancel()
            await asyncio.sleep(0.1)
            sent = last_loopback(kit)
            await asyncio.sleep(0.5)
            assert 0 < sent == last_loopback(kit)

    run(scenario())


@pytest.mark.parametrize("tested", ["pump-1", "pump-2"])
def test_a_stop_during_a_test_is_sent_within_its_bound(tested: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "pump-1")
            bus = kit.service.plant.buses["b"]
            bound_s = bus.stop_bound_s()
            assert bound_s is not None
            test = asyncio.create_task(kit.call("loopback.test", drive=tested, count=100))
            await asyncio.sleep(0.51)
            called_at = bus.bus.now()
            stopped = (await kit.call("drive.stop", drive="pump-1"))["outcome"]
            assert stopped["status"] == "confirmed"
            assert stopped["frames"][0]["sent_at_s"] - called_at <= bound_s
            assert not test.done() or test.result()["complete"]
            test.cancel()

    run(scenario())
