"""The whole ``Drive`` on a pty served by ``drivebus simulate``, and on servers of other projects."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState, DriveStatus
from drivebus.drives.store import MemoryStore
from drivebus.errors import DriveError, LimitError
from drivebus.ports import open_port
from drivebus.values import Quality
from fixtures.station_bench import PROGRAM_TIMEOUT_S
from interop.conftest import StartProgram
from interop.servers import STATION, pymodbus
from peers import need_module

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ptys as Linux has them")

CLI = (sys.executable, "-m", "drivebus")


@dataclass(frozen=True)
class InteropDrive:
    """Family in one encoding, and the state that it reports."""

    model: str
    encoding: str
    run_hz: float
    monitored: float
    """Output frequency that ``monitor`` shows."""
    direction: Direction | None = Direction.FORWARD

    @property
    def reports_running(self) -> bool:
        """Whether the model reports its state; DF800 has no status register, and its state is never inferred (T17)."""
        return self.model != "df800"

    @property
    def monitor(self) -> str:
        return "output_frequency" if self.reports_running else "speed"

    def __str__(self) -> str:
        return f"{self.model}-{self.encoding}"


CASES = [
    InteropDrive("c320", "ascii", 20.0, 20.0),
    InteropDrive("c320", "hex", 20.0, 20.0),
    InteropDrive("dzb100", "ascii", 0.5, 0.5, direction=None),  # capped until its coding is settled (T08)
    InteropDrive("vc660", "rtu", 20.0, 20.0),
    InteropDrive("df800", "rtu", 20.0, 600, direction=None),
    InteropDrive("df800", "ascii", 20.0, 600, direction=None),
]


@pytest.fixture(params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> InteropDrive:
    found: InteropDrive = request.param
    return found


@pytest.fixture
def url(case: InteropDrive, started: StartProgram, tmp_path: Path) -> str:
    return simulated(started, case.model, tmp_path / "drive", "--encoding", case.encoding)


def simulated(started: StartProgram, model: str, link: Path, *more: str) -> str:
    """Return the port URL of a simulated drive at address 3, served by another process."""
    process = started(
        *CLI,
        "simulate",
        "--json",
        "--model",
        model,
        "--address",
        "3",
        "--baud",
        "19200",
        "--ramp",
        "0.5",
        "--link",
        link,
        *more,
    )
    assert process.stdout is not None
    text = process.stdout.readline()
    assert text.startswith("{"), text + process.stdout.read()
    found: str = json.loads(text)["url"]
    return found


def made(bus: Bus, model: str, encoding: str | None = None) -> Drive:
    """Return a drive whose replies may be 0.3 s late, because the machine may be busy."""
    timing = replace(profiles.load(model).timing, adapter_latency_s=0.3)
    options = {"setpoint_step": "0.01"} if model == "c320" else {}
    return Drive(bus, model, 3, encoding=encoding, options=options, store=MemoryStore(), timing=timing)


async def wait_for_reading(drive: Drive, name: str, value: float) -> DriveStatus:
    """Wait until a reading is near the value; returns that status."""
    async with asyncio.timeout(PROGRAM_TIMEOUT_S):
        while True:
            status = await drive.status()
            found = status.readings[name].value
            if isinstance(found, int | float) and abs(found - value) <= 0.05 * value:
                return status


async def test_a_drive_of_every_family_is_read_run_and_stopped_over_a_pty(case: InteropDrive, url: str) -> None:
    async with Bus(open_port(url)) as bus:
        drive = made(bus, case.model, case.encoding)

        before = await drive.status()
        assert before.state is (DriveState.STOPPED if case.reports_running else DriveState.UNKNOWN)
        assert before.fault is None and before.direction is None

        begun = await drive.run(case.run_hz)
        assert begun.status is (OutcomeStatus.CONFIRMED if case.reports_running else OutcomeStatus.ACKNOWLEDGED)
        assert begun.exchanges and all(frame.sent for frame in begun.exchanges)

        turning = await wait_for_reading(drive, case.monitor, case.monitored)
        assert turning.state is (DriveState.RUNNING if case.reports_running else DriveState.UNKNOWN)
        assert turning.direction is case.direction

        ended = await drive.stop()
        assert ended.status is (OutcomeStatus.CONFIRMED if case.reports_running else OutcomeStatus.ACKNOWLEDGED)
        after = await wait_for_reading(drive, case.monitor, 0)
        assert after.state is (DriveState.STOPPED if case.reports_running else DriveState.UNKNOWN)

        sent = bus.statistics().bytes_sent
        with pytest.raises(LimitError):
            await drive.run(400.5)
        assert bus.statistics().bytes_sent == sent, "a frequency above the limit leaves nothing on the wire"
        assert set(bus.statistics().errors) <= {"UntrustedReply"}  # the first loop-back of a port might be its echo


@pytest.mark.parametrize("model", ["c320", "vc660"])
async def test_a_run_waits_until_a_drive_that_reports_its_frequency_is_at_speed(
    model: str, started: StartProgram, tmp_path: Path
) -> None:
    url = simulated(started, model, tmp_path / "drive")
    async with Bus(open_port(url)) as bus:
        drive = made(bus, model)
        reached = await drive.run(35.0, Direction.REVERSE, wait=True)
        assert reached.status is OutcomeStatus.CONFIRMED
        assert reached.params["output_hz"] == pytest.approx(35.0, abs=0.2)
        now = await drive.status()
        assert (now.state, now.direction) == (DriveState.RUNNING, Direction.REVERSE)
        assert (await drive.stop()).status is OutcomeStatus.CONFIRMED


OWN_PROFILE = """
format = 1
model = "other_server"
family = "modbus"
grade = "draft"
maker = { en = "Stranger", zh = "他人" }
title = { en = "Modbus server of another project", zh = "他人的 Modbus 服务器" }
encodings = ["rtu", "ascii"]
addresses = [1, 32]
capabilities = ["read", "write", "run", "stop", "status"]
notation = { style = "register", highest = 127 }
serial = { baud = 115200, format = "8N1", bauds = [115200], formats = ["8N1"], evidence = "user" }
timing = { gap_floor_s = 0.00175, reply_delay_s = 0.5, max_reply_lateness_s = 0.2, evidence = "user" }
limits = { minimum_hz = 0.0, maximum_hz = 50.0, evidence = "user" }
setpoint = { factor = 0.01, decimals = 2, evidence = "user" }
write = { ram = true, eeprom = false, evidence = "user" }
modbus = { functions = [3, 6], max_read = 100, evidence = "user" }

[commands]
register = 0x0040
setpoint_register = 0x0041
evidence = "user"

[commands.bits]
start = { mask = 0x0003, value = 0x0001 }
stop = { mask = 0x0003, value = 0x0002 }

[status]
register = 0x0042          # the servers hold 1066 = 042AH there for ever
bits = { running = 0x0001, fault = 0x0004 }
evidence = "user"

[signals.temperature]
notation = "0010H"
text = { en = "temperature", zh = "温度" }
unit = "°C"
factor = 0.1
decimals = 1
evidence = "user"

[parameters."0011H"]        # beside the signal: a sync probe reads two neighbours
text = { en = "neighbour", zh = "相邻参数" }
evidence = "user"

[parameters."0020H"]
text = { en = "ramp", zh = "斜坡" }
unit = "s"
factor = 0.1
decimals = 1
minimum = 0.0
maximum = 600.0
evidence = "user"

"""


@pytest.fixture(params=["pymodbus-rtu", "pymodbus-ascii", "libmodbus-rtu"])
def other_server(
    request: pytest.FixtureRequest, wire: tuple[str, str], started: StartProgram
) -> Iterator[tuple[str, str]]:
    """Return our end of the wire to another project's server, and its encoding."""
    name, _, encoding = request.param.partition("-")
    our_end, peer_end = wire
    if name == "pymodbus":
        need_module("pymodbus")
        process = pymodbus(started, peer_end, encoding)
    else:
        process = started(request.getfixturevalue("libmodbus_server"), peer_end, STATION)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    yield f"serial://{our_end}?baud=115200&format=8N1", encoding


async def test_a_user_profile_reads_and_writes_another_projects_server(
    other_server: tuple[str, str], tmp_path: Path
) -> None:
    """The profile alone names registers, units and scales; a write is confirmed by reading it back."""
    url, encoding = other_server
    own = tmp_path / "other_server.toml"
    own.write_text(OWN_PROFILE, encoding="utf-8")
    async with Bus(open_port(url)) as bus:
        drive = Drive(bus, own, STATION, encoding=encoding, store=MemoryStore())
        found: dict[str, Any] = await drive.read(["temperature", "0020H", "0011H"])
        assert (found["temperature"].value, found["temperature"].unit) == (101.6, "°C")
        assert (found["0020H"].value, found["0020H"].raw, found["0020H"].quality) == (103.2, 1032, Quality.GOOD)
        written = await drive.write({"0020H": 12.5})
        assert written.status is OutcomeStatus.CONFIRMED
        again = await drive.read(["0020H", "0011H"])
        assert (again["0020H"].raw, again["0011H"].raw) == (125, 1017)
        with pytest.raises(LimitError):
            await drive.write({"0020H": 600.1})


@pytest.mark.parametrize("other_server", ["libmodbus-rtu"], indirect=True)
async def test_a_start_that_is_answered_without_the_drive_running_is_not_confirmed(
    other_server: tuple[str, str], tmp_path: Path
) -> None:
    """The reply to the start does not confirm it; the status word is read and shows standstill."""
    url, encoding = other_server
    own = tmp_path / "other_server.toml"
    own.write_text(OWN_PROFILE, encoding="utf-8")
    async with Bus(open_port(url)) as bus:
        drive = Drive(bus, own, STATION, encoding=encoding, store=MemoryStore())
        with pytest.raises(DriveError) as caught:
            await drive.run(10.0)
        assert caught.value.outcome.status is OutcomeStatus.FAILED
        starts = [frame for frame in caught.value.outcome.exchanges if frame.sent[1:6] == bytes((6, 0, 0x40, 0, 1))]
        assert len(starts) == 1, "an answered start is never sent again"
        assert starts[0].received == starts[0].sent
