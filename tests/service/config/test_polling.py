"""The load estimate of ``check`` holds in a running plant: the same polls, and the estimated refresh."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus.prepared_request import Poll
from drivebus.drives import Drive
from drivebus.drives.monitor import Monitor
from drivebus.ports import open_port
from drivebus.service import config
from drivebus.service.config.model import DriveConfig, PlantConfig
from drivebus.testing import virtual_time


def plant(model: str, count: int, more: str = "", line: str = "") -> PlantConfig:
    drives = "".join(
        f'[drive.d{n}]\nbus = "a"\naddress = {n}\nmodel = "{model}"\n{more}\n' for n in range(1, count + 1)
    )
    text = f'format = 1\n[plant]\nid = "p"\n[bus.a]\nlink = "sim://{model}@1-{count}{line}"\n{drives}'
    return config.loads(text)


def watched(bus: Bus, setting: DriveConfig) -> tuple[Drive, list[Poll]]:
    """Return a drive of a running plant and the polls of its monitor."""
    recorded: list[Poll] = []
    drive = Drive(bus, config.profile_of(setting), setting.address, encoding=setting.encoding, options=setting.options)
    real = bus.start_polling

    def watch(address: int, polls: Any, sink: Any) -> Any:
        recorded.extend(polls)
        return real(address, polls, sink)

    bus.start_polling = watch  # type: ignore[method-assign]
    drive.monitor(tuple(setting.signals) or None, period_s=setting.min_poll_interval_s)
    return drive, recorded


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
@pytest.mark.parametrize("more", ["", "signals = { output_current = 3.0 }", "min_poll_interval_s = 1.5"])
def test_the_estimated_polls_are_those_that_are_sent(model: str, more: str) -> None:
    if model == "c320":
        more = more.replace("output_current", "output_voltage")
    setting = plant(model, 1, more).drives[0]

    async def tale() -> None:
        async with Bus(open_port(f"sim://{model}@1")) as bus:
            _, polls = watched(bus, setting)
            wanted = config.polls_of(setting, config.dialect_of(setting))
            assert [(one.request, one.period_s) for one in polls] == [(one.request, one.period_s) for one in wanted]
            assert len(polls) >= 1

    virtual_time.run(tale())


async def longest_gaps(setting: PlantConfig, seconds: float) -> dict[str, float]:
    """Return for each drive the longest time between two values of its most frequent signal."""
    port = open_port(setting.buses[0].link)
    gaps: dict[str, float] = {}
    async with Bus(port) as bus:
        monitors: list[Monitor] = []
        for one in setting.drives:
            drive = Drive(bus, config.profile_of(one), one.address)
            name = min(config.bus_loads(setting)[0].drives[0].periods.items(), key=lambda item: item[1])[0]
            last: list[float] = []

            def received(status: Any, id: str = one.id, name: str = name, last: list[float] = last) -> None:
                at = status.readings[name].source_time
                if at is not None and at not in last[-1:]:
                    gaps[id] = max(gaps.get(id, 0.0), at - last[-1]) if last else 0.0
                    last.append(at)

            monitors.append(drive.monitor(tuple(one.signals) or None, received, one.min_poll_interval_s))
        await asyncio.sleep(seconds)
        for monitor in monitors:
            monitor.close()
    return gaps


@pytest.mark.parametrize(("model", "count"), [("c320", 3), ("c320", 12), ("dzb100", 2), ("vc660", 6), ("df800", 3)])
def test_a_bus_keeps_the_estimated_refresh(model: str, count: int) -> None:
    """Every drive on one bus, without configured periods."""
    setting = plant(model, count)
    bus = config.bus_loads(setting)[0]
    promised_s, period_s = min(bus.drives[0].refresh.values()), min(bus.drives[0].periods.values())
    gaps = virtual_time.run(longest_gaps(setting, 40 * period_s))
    assert gaps.keys() == {one.id for one in setting.drives}
    assert period_s <= max(gaps.values()) <= promised_s
