"""The load estimate of ``check`` holds in a running plant: the same polls, and the estimated refresh."""

from __future__ import annotations

import asyncio
import re
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus.prepared_request import Poll
from drivebus.drives import Drive
from drivebus.drives.monitor import Monitor
from drivebus.errors import ConfigurationError
from drivebus.ports import open_port
from drivebus.service import config
from drivebus.service.config.model import DriveConfig, PlantConfig
from drivebus.testing import virtual_time


def plant(model: str, count: int, more: str = "", line: str = "") -> PlantConfig:
    drives = "".join(
        f'[drive.d{n}]\nbus = "a"\naddress = {n}\nmodel = "{model}"\n{more}\n' for n in range(1, count + 1)
    )
    text = f'format = 1\n[plant]\nid = "p"\n[bus.a]\nport = "sim://{model}@1-{count}{line}"\n{drives}'
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
            assert [(poll.request, poll.period_s) for poll in polls] == [
                (poll.request, poll.period_s) for poll in wanted
            ]
            assert len(polls) >= 1

    virtual_time.run(tale())


async def longest_gaps(plant_config: PlantConfig, seconds: float) -> dict[str, float]:
    """Return for each drive the longest time between two values of its most frequent signal."""
    port = open_port(plant_config.buses[0].port)
    gaps: dict[str, float] = {}
    async with Bus(port) as bus:
        monitors: list[Monitor] = []
        for setting in plant_config.drives:
            drive = Drive(bus, config.profile_of(setting), setting.address)
            name = min(config.bus_loads(plant_config)[0].drives[0].periods.items(), key=lambda item: item[1])[0]
            last: list[float] = []

            def received(status: Any, id: str = setting.id, name: str = name, last: list[float] = last) -> None:
                at = status.readings[name].source_time
                if at is not None and at not in last[-1:]:
                    gaps[id] = max(gaps.get(id, 0.0), at - last[-1]) if last else 0.0
                    last.append(at)

            monitors.append(drive.monitor(tuple(setting.signals) or None, received, setting.min_poll_interval_s))
        await asyncio.sleep(seconds)
        for monitor in monitors:
            monitor.close()
    return gaps


@pytest.mark.parametrize(("model", "count"), [("c320", 3), ("c320", 12), ("dzb100", 2), ("vc660", 6), ("df800", 3)])
def test_a_bus_keeps_the_estimated_refresh(model: str, count: int) -> None:
    """Every drive on one bus, without configured periods."""
    plant_config = plant(model, count)
    bus = config.bus_loads(plant_config)[0]
    promised_s, period_s = min(bus.drives[0].refresh.values()), min(bus.drives[0].periods.values())
    gaps = virtual_time.run(longest_gaps(plant_config, 40 * period_s))
    assert gaps.keys() == {drive.id for drive in plant_config.drives}
    assert period_s <= max(gaps.values()) <= promised_s


def test_drives_with_periods_of_their_own_are_paced_too() -> None:
    """The state of 30 drives twice a second was 533 % of the bus, although the file asks for one value in 10 s."""
    paced = plant("vc660", 30, "signals = { output_current = 10.0 }")
    bus = config.bus_loads(paced)[0]
    assert bus.load_percent <= 100
    assert {drive.periods["output_current"] for drive in bus.drives} == {10.0}
    polls = config.polls_of(paced.drives[0], config.dialect_of(paced.drives[0]))
    assert max(poll.period_s for poll in polls) == 10.0
    assert min(poll.period_s for poll in polls) == paced.drives[0].min_poll_interval_s > 1.0


def test_the_chosen_interval_never_lengthens_a_configured_period() -> None:
    """A drive with a period of 1 s keeps it; the other drives of the bus share the remaining time."""
    text = (
        'format = 1\n[plant]\nid = "p"\n[bus.a]\nport = "sim://vc660@1-30"\n'
        '[drive.fast]\nbus = "a"\naddress = 1\nmodel = "vc660"\nsignals = { output_current = 1.0 }\n'
    ) + "".join(f'[drive.d{n}]\nbus = "a"\naddress = {n}\nmodel = "vc660"\n' for n in range(2, 31))
    fast, *others = config.loads(text).drives
    assert fast.min_poll_interval_s == 1.0
    assert min(drive.min_poll_interval_s for drive in others) > 10.0


def overload_of(model: str, count: int, more: str, line: str = "") -> str:
    with pytest.raises(ConfigurationError) as found:
        plant(model, count, more, line)
    return str(found.value)


def test_the_interval_that_an_overload_names_is_accepted() -> None:
    more = "signals = { output_current = 0.5 }"
    named = re.search(r"write (min_poll_interval_s = [\d.]+) in each", overload_of("vc660", 30, more))
    assert named is not None
    assert config.bus_loads(plant("vc660", 30, f"{more}\n{named[1]}"))[0].load_percent <= 100


def test_an_overload_that_no_interval_mends_names_none_to_write() -> None:
    text = overload_of("c320", 30, "", "?baud=1200")
    assert "more drives than the bus can carry" in text and "write min_poll_interval_s" not in text
