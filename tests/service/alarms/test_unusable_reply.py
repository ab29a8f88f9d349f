"""The service names what a drive sends that is not online; only of a silent one it says that it does not reply."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from drivebus import i18n
from drivebus.cli.formatting import status_json
from drivebus.cli.remote.convert import parse_status
from drivebus.service.config.model import BusConfig, DriveConfig
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import ServiceKit, plant_config, running_service

FIRST_ALARM_S = 15.0


def plant(model: str) -> Any:
    drive = DriveConfig(id="fan", bus="a", address=1, model=model)
    return plant_config(buses=(BusConfig("a", f"sim://{model}@1"),), drives=(drive,), groups=())


def set_replies(kit: ServiceKit, replies: Callable[[bytes], bytes], *, delay_s: float = 0.0) -> None:
    wire = kit.simulated_bus("fan").wire
    transmit = wire.transmit_reply
    wire.transmit_reply = lambda source, data, now, at: transmit(  # type: ignore[method-assign]
        source, replies(data), now, at + delay_s
    )


def misbehave(kit: ServiceKit, key: str) -> None:
    if key == "bus.stray_before":
        set_replies(kit, lambda reply: b"\x00" + reply)
    elif key == "bus.second_reply":
        set_replies(kit, lambda reply: reply + reply)
    elif key == "bus.late_reply":
        set_replies(kit, lambda reply: reply, delay_s=0.7)


def uncleared(kit: ServiceKit) -> list[Any]:
    return [alarm for alarm in kit.service.plant.alarms.active() if alarm.cleared_ms is None]


def last_event(kit: ServiceKit) -> Json:
    return [event["text"] for _, event in kit.service.plant.hub.items("events") if event["kind"] == "presence"][-1]


@pytest.mark.parametrize("key", ["bus.stray_before", "bus.second_reply", "bus.late_reply"])
@pytest.mark.parametrize("model", ["c320", "vc660"])
@pytest.mark.parametrize("seen_before", [True, False])
def test_a_drive_that_answers_unusably_is_not_called_silent(model: str, key: str, seen_before: bool) -> None:
    async def scenario() -> None:
        async with running_service(plant(model)) as kit:
            await asyncio.sleep(5 if seen_before else 0.001)  # its bus is open, and no reply has come
            presence = (await kit.call("drives.get", drive="fan"))["presence"]
            assert (presence, uncleared(kit)) == ("online" if seen_before else "never_seen", [])
            misbehave(kit, key)
            await asyncio.sleep(FIRST_ALARM_S)
            view = await kit.call("drives.get", drive="fan")
            error = view["unusable_reply"]
            assert (error["code"], view["state"], view["state_reason"]) == (key, "unknown", "drives.no_answer")
            [alarm] = uncleared(kit)
            assert (alarm.kind, alarm.title.en, alarm.title.zh) == ("no_response", "No usable reply", "没有可用的应答")
            for language, says in (("en", "fan: no usable reply: "), ("zh", "fan：没有可用的应答：")):
                assert i18n.text("plant.drive_unusable_reply", language, drive="fan", reason="") == says
                expected = i18n.text("alarms.text.unusable_reply", language, drive="fan", unusable_reply="{}")
                assert expected.startswith(says + "{}")
                assert alarm.text.by_language()[language] == expected.replace("{}", error["text"][language])
                assert alarm.remedy.by_language()[language] == i18n.text(f"hint.{key}", language)
                if seen_before:
                    assert last_event(kit)[language].startswith(says), last_event(kit)
            assert status_json(parse_status(view, 0.0), 0.0)["reason"] == error["text"]["en"]

    run(scenario())


def test_of_a_silent_drive_the_service_says_that_it_does_not_reply() -> None:
    async def scenario() -> None:
        async with running_service(plant("c320")) as kit:
            await asyncio.sleep(5)
            kit.station("fan").faults.silent = True
            await asyncio.sleep(FIRST_ALARM_S)
            view = await kit.call("drives.get", drive="fan")
            assert (view["unusable_reply"], view["state_reason"]) == (None, "drives.stale")
            [alarm] = uncleared(kit)
            assert alarm.text.en == "fan does not reply; it is unknown whether its motor runs"
            assert last_event(kit)["en"] == "fan no longer replies"

    run(scenario())


def test_a_silent_drive_that_begins_to_answer_unusably_gets_another_alarm_at_once_and_only_one() -> None:
    """A drive that falls silent after that gets no third alarm: no usable reply comes then either."""

    async def scenario() -> None:
        async with running_service(plant("c320")) as kit:
            faults = kit.station("fan").faults
            faults.silent = True
            await asyncio.sleep(FIRST_ALARM_S)
            assert [alarm.text.en.startswith("fan does not reply") for alarm in uncleared(kit)] == [True]
            misbehave(kit, "bus.stray_before")
            for silent in (False, True):
                faults.silent = silent
                for _ in range(300):
                    await asyncio.sleep(0.5)
                    assert len(uncleared(kit)) == 1, "no time without an alarm"
                assert uncleared(kit)[0].value == "bus.stray_before"
                view = await kit.call("drives.get", drive="fan")
                assert (view["unusable_reply"] is None) == silent
            assert [(alarm.kind, alarm.count) for alarm in kit.service.plant.alarms.active()] == [("no_response", 2)]

    run(scenario())
