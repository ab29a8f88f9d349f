"""A protocol family of another package works everywhere: its one folder is all that is added.

``tests/fixtures/toy_family`` holds codec, dialect, simulated drive, profile, descriptions and texts of an invented
drive; an entry point registers it. No file of drivebus names it.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import CapabilityError, LimitError
from drivebus.ports import open_port
from drivebus.protocols.family import (
    clear_registry,
    common_scan_models,
    protocol_families,
    protocol_family,
    register,
    resolve,
)
from drivebus.service.auth.actor import local_actor
from drivebus.service.config.model import BusConfig, DriveConfig
from drivebus.service.ipc.client import SocketClient
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing import virtual_time
from drivebus.values import Text
from fixtures.child_process import COMMAND
from fixtures.service import plant_config, running_service
from fixtures.web_app import WebAppHarness

TOY_FOLDER = Path(__file__).parents[1] / "fixtures" / "toy_family"
SOURCE_FOLDER = Path(profiles.__file__).parents[1]
RUN_FRAME = "{01C0107D0E0}"
"""Run forward at 20.00 Hz, to station 1."""
ACTOR = local_actor("tester", "t-1")
PLANT = """
format = 1
[plant]
id = "toys"
title = "Toys"
directory = "{directory}"
[gateway.web]
port = 0
[bus.a]
port = "sim://toy1@1?ramp=0.5"
[drive.toy-1]
bus = "a"
address = 1
model = "toy1"
"""


def environment(**more: str) -> dict[str, str]:
    """Environment of a child process in which the family's package is installed."""
    path = os.pathsep.join(filter(None, (str(TOY_FOLDER), os.environ.get("PYTHONPATH", ""))))
    return os.environ | {"PYTHONPATH": path, "DRIVEBUS_LANG": "en", "PYTHONUNBUFFERED": "1"} | more


def command(*words: str, **more: str) -> tuple[int, Any]:
    """Exit code and last JSON document of a drivebus command."""
    done = subprocess.run(
        [*COMMAND, *words, "--json"], capture_output=True, text=True, env=environment(**more), timeout=60, check=False
    )
    assert done.stdout, done.stderr
    try:
        return done.returncode, json.loads(done.stdout)
    except json.JSONDecodeError:
        return done.returncode, json.loads(done.stdout.splitlines()[-1])


@contextmanager
def simulated_drive() -> Iterator[str]:
    """URL of a simulated toy drive on a TCP port."""
    words = [
        "simulate",
        "--json",
        "--model",
        "toy1",
        "--address",
        "1",
        "--ramp",
        "0.5",
        "--bind",
        "tcp://127.0.0.1:0",
    ]
    child = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True, env=environment())
    try:
        assert child.stdout is not None
        yield json.loads(child.stdout.readline())["url"]
    finally:
        child.kill()
        child.communicate()


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The family's package on this process's path."""
    monkeypatch.syspath_prepend(str(TOY_FOLDER))
    clear_registry()
    yield
    clear_registry()
    for name in [name for name in sys.modules if name.split(".")[0] == "drivebus_toy"]:
        del sys.modules[name]


def test_no_file_of_drivebus_names_the_family() -> None:
    files = [path for path in SOURCE_FOLDER.rglob("*") if path.suffix in (".py", ".toml", ".json", ".js")]
    assert len(files) > 400
    assert [path for path in files if "toy" in path.read_text(encoding="utf-8").lower().split()] == []
    assert [path for path in files if '"toy' in path.read_text(encoding="utf-8")] == []


def test_the_registry_finds_the_family_by_its_entry_point(installed: None) -> None:
    assert [family.name for family in protocol_families()] == [
        "sunfar",
        "dzb100",
        "modbus",
        "huanyang",
        "mitsubishi",
        "toy",
    ]
    assert protocol_family("toy").max_error_rate == 0.005
    assert common_scan_models()[-1] == "toy1"


def test_a_family_can_be_registered_without_an_entry_point_but_not_replace_a_built_in_one(installed: None) -> None:
    family = protocol_family("toy")
    register(family)
    assert protocol_family("toy") is family
    with pytest.raises(ValueError, match="modbus is built in"):
        register(resolve("drivebus.protocols.modbus.family:FAMILY"))


def test_models_and_profile_check_know_its_profile() -> None:
    code, found = command("models")
    assert code == 0
    assert {profile["model"]: profile["family"] for profile in found["models"]}["toy1"] == "toy"
    code, _ = command("profile", "check", str(TOY_FOLDER / "drivebus_toy" / "profiles" / "toy1.toml"))
    assert code == 0


@pytest.mark.parametrize(("language", "label"), [("en", "toy command"), ("zh", "玩具命令")])
def test_decode_describes_a_frame_in_both_languages(language: str, label: str) -> None:
    frame = RUN_FRAME.encode().hex()
    code, found = command("decode", "--model", "toy1", frame)
    assert code == 0
    assert (found["family"], found["valid"], found["fields"]["data"]) == ("toy", True, 2000)
    assert len(found["hazards"]) == 1
    words = [*COMMAND, "decode", "--model", "toy1", "--lang", language, frame]
    text = subprocess.run(words, capture_output=True, text=True, env=environment(), check=True, timeout=60).stdout
    assert label in text and "toy." not in text


def test_decode_names_what_is_wrong() -> None:
    code, found = command("decode", "--model", "toy1", RUN_FRAME.replace("E0}", "E1}").encode().hex())
    assert code == 3
    assert found["problems"] == ["checksum 00E1H received, 00E0H computed"]


def test_scan_finds_the_drive() -> None:
    words = ("scan", "sim://toy1@3", "--models", "toy1,vc660", "--addresses", "1-4", "--listen-seconds", "0.1")
    code, found = command(*words)
    assert code == 0
    drives = [drive for drive in found["found"] if drive["valid_reply"]]
    assert [(drive["models"], drive["family"], drive["address"]) for drive in drives] == [(["toy1"], "toy", 3)]


def test_a_simulated_drive_reports_runs_and_stops() -> None:
    with simulated_drive() as url:
        drive = (url, "--model", "toy1", "--address", "1")
        code, found = command("status", *drive)
        assert code == 0 and found["state"] == "stopped"
        code, found = command("run", *drive, "--frequency", "20", "--reverse", "--wait", "--detach")
        assert code == 0 and found["outcome"] == "confirmed", found
        code, found = command("status", *drive)
        assert (found["state"], found["direction"]) == ("running", "reverse")
        code, found = command("stop", *drive)
        assert code == 0 and found["outcome"] == "confirmed", found
        code, found = command("read", *drive, "T16")
        assert code == 0, found


def test_serve_polls_starts_and_stops_the_drive(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT.format(directory=tmp_path / "state"), encoding="utf-8")
    process = subprocess.Popen(
        [*COMMAND, "serve", str(file)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("Plant toys"), (line, process.stderr and process.stderr.read())
        asyncio.run(asyncio.wait_for(_start_and_stop(tmp_path / "state" / "plant.sock"), 60))
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 0


async def _start_and_stop(socket: Path) -> None:
    client = SocketClient(socket)
    await _wait_for_state(client, "stopped")
    await client.call("waiver.grant", {"drive": "toy-1", "reason": "test bench"}, ACTOR)
    started = await client.call("drive.run", {"drive": "toy-1", "frequency_hz": 20.0}, ACTOR)
    await _wait_for_state(client, "running")
    stopped = await client.call("drive.stop", {"drive": "toy-1"}, ACTOR)
    assert started and stopped
    await _wait_for_state(client, "stopped")
    await client.close()


async def _wait_for_state(client: SocketClient, state: str) -> None:
    while True:
        found = {view["id"]: view for view in (await client.call("drives.list", {}, ACTOR))["drives"]}
        if found.get("toy-1", {}).get("state") == state:
            return
        await asyncio.sleep(0.1)


def test_a_drive_with_an_unknown_step_is_capped_until_it_is_calibrated(installed: None) -> None:
    async def scenario() -> None:
        port = open_port("sim://toy1@1?ramp=0.5")
        async with Bus(port) as bus:
            station = simulated_bus_of(port).station(1)
            drive = Drive(bus, "toy1", 1, options={"frequency_step": "unknown"}, store=MemoryStore())
            assert [step.name for step in drive.open_calibrations()] == ["frequency_step"]
            with pytest.raises(LimitError):
                await drive.run(20.0)
            assert not station.running
            station.setpoint_hz = 12.3
            found = await drive.calibrate("frequency_step")
            assert found.options == {"frequency_step": "0.01"}
            assert drive.open_calibrations() == ()
            assert (await drive.run(20.0)).status == "confirmed"
            await drive.stop()
            with pytest.raises(CapabilityError):
                await drive.calibrate("direction")

    virtual_time.run(scenario())


def test_the_page_gets_the_drive_and_its_profile(installed: None, tmp_path: Path) -> None:
    chosen = plant_config(
        buses=(BusConfig("a", "sim://toy1@1?ramp=0.5"),),
        drives=(DriveConfig(id="toy-1", bus="a", address=1, model="toy1", title=Text("Toy 1", "玩具 1")),),
        groups=(),
    )

    async def requests() -> None:
        async with running_service(chosen) as kit:
            web = WebAppHarness(tmp_path, service=kit.service)
            client = await web.log_in("viewer")
            view: dict[str, Any] = {}
            for _ in range(100):
                view = (await client.get("/api/v1/drives/toy-1")).json()
                if view["state"] == "stopped":
                    break
                await asyncio.sleep(0.1)
            assert (view["model"], view["state"]) == ("toy1", "stopped")
            profile = (await client.get("/api/v1/drives/toy-1/profile")).json()
            assert (profile["family"], profile["title"]["zh"]) == ("toy", "玩具变频器")
            texts = (await client.get("/i18n/zh.json")).json()
            assert texts["toy.rejected"] == "玩具变频器拒绝该命令"
            assert (await client.get("/")).status_code == 200
            await client.aclose()

    asyncio.run(asyncio.wait_for(requests(), 60))
