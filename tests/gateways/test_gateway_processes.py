"""Gateways are child processes of the service: killing or freezing one disturbs neither the service nor the others.

``tests/fixtures/toy_gateway`` is a gateway of another package; its entry point is all that registers it.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from drivebus import profiles
from drivebus.errors import DrivebusError
from drivebus.gateways import process
from drivebus.service.auth.actor import local_actor
from drivebus.service.config.model import GatewayConfig
from drivebus.service.ipc.client import SocketClient
from drivebus.service.process import gateways
from drivebus.service.process.gateway_arguments import ADDRESS_USED_EXIT_CODE
from drivebus.service.process.gateways import RELOAD_LINE, ChildProcess, GatewaySupervisor, report_used_ports
from drivebus.types import Json
from fixtures.child_process import COMMAND

TOY_FOLDER = Path(__file__).parents[1] / "fixtures" / "toy_gateway"
ACTOR = local_actor("tester", "t-1")
TIMEOUT_S = 60.0
ANSWER_TIMEOUT_S = 2.0
"""Answers of the service take milliseconds; a machine that runs other tests gets this long for the fastest of three."""
PLANT = """
format = 1
[plant]
id = "hall"
directory = "state"
[bus.a]
port = "sim://c320@1,2?ramp=0.5"
[drive.fan-1]
bus = "a"
address = 1
model = "./c320.toml"
limits = { maximum_hz = 25.0 }
[drive.fan-2]
bus = "a"
address = 2
model = "./c320.toml"
[interlock.together]
drives = ["fan-2"]
require = "fan-1.output_frequency < 15 Hz"
[gateway.web]
port = 0
[gateway.toy]
file = "toy.jsonl"
"""


def write_plant(folder: Path, text: str = PLANT) -> Path:
    """Write a plant file, and a profile that allows for late replies of a simulator on a loaded machine."""
    (profile,) = Path(profiles.__file__).parent.glob("data/*/c320.toml")
    patient = profile.read_text(encoding="utf-8").replace("[timing]\n", "[timing]\nadapter_latency_s = 1.0\n")
    (folder / "c320.toml").write_text(patient, encoding="utf-8")
    file = folder / "plant.toml"
    file.write_text(text, encoding="utf-8")
    return file


def environment() -> dict[str, str]:
    """Environment of a service in which the toy gateway's package is installed."""
    path = os.pathsep.join(filter(None, (str(TOY_FOLDER), os.environ.get("PYTHONPATH", ""))))
    return os.environ | {"PYTHONPATH": path, "DRIVEBUS_LANG": "en", "PYTHONUNBUFFERED": "1"}


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *words], capture_output=True, text=True, env=environment(), timeout=TIMEOUT_S, check=False
    )


class RunningPlant:
    """A served plant with both gateways, as a client of its socket sees it."""

    def __init__(self, folder: Path, process: subprocess.Popen[str]) -> None:
        self.folder, self.process = folder, process
        self.client = SocketClient(folder / "state" / "plant.sock")
        self.page = ""

    async def call(self, operation: str, **params: Any) -> Json:
        async with asyncio.timeout(TIMEOUT_S):
            return await self.client.call(operation, params, ACTOR)

    async def gateways(self) -> dict[str, Json]:
        return {gateway["id"]: gateway for gateway in (await self.call("plant.get"))["gateways"]}

    async def events(self) -> list[Json]:
        stream = self.client.live("state", ACTOR)
        snapshot = await anext(stream)
        await stream.aclose()  # type: ignore[attr-defined]
        events: list[Json] = snapshot["topics"]["events"]
        return events

    async def drive(self, id: str) -> Json:
        return {drive["id"]: drive for drive in (await self.call("drives.list"))["drives"]}[id]

    async def wait_for(self, condition: Callable[[], Awaitable[bool]]) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not await condition():  # noqa: ASYNC110  a condition of another process
                await asyncio.sleep(0.05)

    async def wait_for_state(self, drive: str, state: str) -> None:
        async def reached() -> bool:
            return bool((await self.drive(drive))["state"] == state)

        await self.wait_for(reached)

    async def progress(self) -> tuple[int, int]:
        """Replies on the bus, and samples of the history."""
        buses = (await self.call("buses.list"))["buses"]
        return buses[0]["replies"], (await self.call("plant.statistics"))["history"]["samples"]

    async def check_service_works(self) -> None:
        """Polls and history go on; a limit rejects, an interlock stops, the stop socket stops."""
        before = await self.progress()

        async def advanced() -> bool:
            return all(now > then + 5 for now, then in zip(await self.progress(), before, strict=True))

        await self.wait_for(advanced)
        with pytest.raises(DrivebusError):
            await self.call("drive.run", drive="fan-1", frequency_hz=30.0)
        await self.call("drive.run", drive="fan-2", frequency_hz=20.0)
        await self.wait_for_state("fan-2", "running")
        await self.call("drive.run", drive="fan-1", frequency_hz=20.0)
        await self.wait_for_state("fan-2", "stopped")
        await self.wait_for_state("fan-1", "running")
        stopped = await asyncio.to_thread(command, "stop", "--all", str(self.folder / "plant.toml"), "--json")
        assert stopped.returncode == 0, stopped
        assert json.loads(stopped.stdout)["buses"]["a"]["confirmed"] is True
        await self.wait_for_state("fan-1", "stopped")


@asynccontextmanager
async def running_plant(folder: Path) -> AsyncIterator[RunningPlant]:
    file = write_plant(folder)
    process = subprocess.Popen(  # noqa: ASYNC220  it takes milliseconds
        [*COMMAND, "serve", str(file)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    try:
        assert process.stdout is not None and process.stderr is not None
        line = await asyncio.to_thread(process.stdout.readline)
        assert line.startswith("Plant hall is running"), (line, process.stderr.read())
        plant = RunningPlant(folder, process)
        plant.page = (await asyncio.to_thread(process.stdout.readline)).strip()
        for drive in ("fan-1", "fan-2"):
            await plant.wait_for_state(drive, "stopped")
            await plant.call("waiver.grant", drive=drive, reason="test bench")
        yield plant
        await plant.client.close()
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            await asyncio.to_thread(process.communicate, timeout=TIMEOUT_S)
            assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()


async def wait_until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while not condition():  # noqa: ASYNC110  other processes have no event of this loop
            await asyncio.sleep(0.05)


def size_of(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0


async def wait_for_growth(file: Path) -> None:
    """Wait until the toy gateway has written more."""
    before = size_of(file)
    await wait_until(lambda: size_of(file) > before)


def is_running(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def arguments_of(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/cmdline").read_text().split("\0")[1:-1]


@pytest.mark.parametrize(("killed", "other"), [("web", "toy"), ("toy", "web")])
async def test_a_killed_gateway_is_restarted_and_disturbs_nothing_else(killed: str, other: str, tmp_path: Path) -> None:
    async with running_plant(tmp_path) as plant:
        await wait_for_growth(tmp_path / "toy.jsonl")
        before = await plant.gateways()
        os.kill(before[killed]["pid"], signal.SIGKILL)

        async def waits() -> bool:
            return (await plant.gateways())[killed]["pid"] != before[killed]["pid"]

        await plant.wait_for(waits)
        await plant.check_service_works()

        async def runs() -> bool:
            return bool((await plant.gateways())[killed]["running"])

        await plant.wait_for(runs)
        after = await plant.gateways()
        assert after[other] == before[other], "the other gateway is the same process"
        assert (after[killed]["starts"], after[killed]["exit_code"]) == (2, -signal.SIGKILL)
        await wait_for_growth(tmp_path / "toy.jsonl")
        (event,) = [event for event in await plant.events() if event["kind"] == "gateway"]
        assert f"gateway {killed} ended with exit code -9" in event["text"]["en"]
        assert f"网关 {killed} 已结束，退出码 -9" in event["text"]["zh"]


async def test_a_frozen_gateway_delays_neither_the_service_nor_the_other_gateway(tmp_path: Path) -> None:
    async with running_plant(tmp_path) as plant, httpx.AsyncClient(base_url=plant.page) as client:
        pids = {name: gateway["pid"] for name, gateway in (await plant.gateways()).items()}
        assert arguments_of(pids["toy"]) == ["-P", "-m", "drivebus_toy_gateway"], "no settings in the list of processes"
        await wait_for_growth(tmp_path / "toy.jsonl")
        os.kill(pids["toy"], signal.SIGSTOP)
        await plant.check_service_works()
        durations_s = []
        for _ in range(3):
            begun = time.monotonic()
            await plant.call("plant.get")
            assert (await client.get("/api/v1/health")).status_code == 200
            durations_s.append(time.monotonic() - begun)
        assert min(durations_s) < ANSWER_TIMEOUT_S
        assert {name: gateway["pid"] for name, gateway in (await plant.gateways()).items()} == pids
        os.kill(pids["toy"], signal.SIGCONT)
        await wait_for_growth(tmp_path / "toy.jsonl")
        os.kill(pids["toy"], signal.SIGSTOP)  # the service ends it nevertheless
    assert not is_running(pids["toy"])


async def test_a_reload_restarts_only_the_gateway_whose_table_changed(tmp_path: Path) -> None:
    async with running_plant(tmp_path) as plant:
        before, file = await plant.gateways(), tmp_path / "plant.toml"

        async def reload(text: str) -> Json:
            file.write_text(text, encoding="utf-8")
            return await plant.call("configuration.reload")

        changed = PLANT.replace('"toy.jsonl"', '"other.jsonl"')
        answer = await reload(changed)
        assert answer == {
            "difference": {"added": [], "changed": ["toy"], "removed": []},
            "restart": [],
            "notes": [],
        }
        await wait_for_growth(tmp_path / "other.jsonl")
        after = await plant.gateways()
        assert after["web"] == before["web"] and after["toy"]["pid"] != before["toy"]["pid"]
        assert not is_running(before["toy"]["pid"])

        answer = await reload(changed + "enabled = false\n")
        assert answer["difference"]["changed"] == ["toy"]
        assert await plant.gateways() == {"web": before["web"]}
        answer = await reload(PLANT.partition("[gateway.toy]")[0])
        assert answer["difference"]["removed"] == ["toy"]
        await reload(PLANT)
        await wait_for_growth(tmp_path / "toy.jsonl")
        assert (await plant.gateways())["web"] == before["web"]


async def test_a_killed_service_takes_its_gateways_with_it(tmp_path: Path) -> None:
    async with running_plant(tmp_path) as plant:
        pids = [gateway["pid"] for gateway in (await plant.gateways()).values()]
        await wait_until(lambda: size_of(tmp_path / "toy.jsonl") > 0)
        plant.process.kill()
        await wait_until(lambda: not any(is_running(pid) for pid in pids))


def test_check_and_serve_name_file_line_key_and_remedy_of_a_gateways_table(tmp_path: Path) -> None:
    file = write_plant(tmp_path, PLANT.replace('"toy.jsonl"', '"none/toy.jsonl"\ninterval_s = 0.0'))
    for word in ("check", "serve"):
        done = command(word, str(file))
        assert done.returncode == 2 and "Traceback" not in done.stderr
        text = done.stdout + done.stderr
        assert f"{file}:24: gateway.toy.interval_s: number out of range" in text, text
        assert "0.0 found, >= 0.1 expected; correct the number" in text


def test_check_runs_the_gateways_own_check_with_its_own_texts(tmp_path: Path) -> None:
    file = write_plant(tmp_path, PLANT.replace('"toy.jsonl"', '"none/toy.jsonl"'))
    done = command("check", str(file))
    assert done.returncode == 2
    assert "gateway.toy.file: a file in a folder that does not exist" in done.stdout + done.stderr
    assert "create the folder or correct the path" in done.stdout + done.stderr


def test_serve_without_a_gateway_does_not_start_it_and_names_the_known_ones(tmp_path: Path) -> None:
    file = write_plant(tmp_path)
    done = command("serve", str(file), "--without", "mqtt")
    assert done.returncode == 2 and "toy, web" in done.stdout + done.stderr


def other_package(folder: Path, name: str, target: str) -> Path:
    """A package whose only content is an entry point for a gateway."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[drivebus.gateways]\n{target}\n")
    return folder


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("lost = no_such_module:GATEWAY", "No module named 'no_such_module'"),
        ("lost = drivebus.web.gateway:NONE", "has no attribute 'NONE'"),
        ("lost = drivebus.web.gateway:GATEWAY", "it is no Gateway with the name lost"),
        ("web = drivebus.web.gateway:WebTable", "has the same name"),
    ],
)
@pytest.mark.parametrize("word", ["check", "serve"])
def test_an_entry_point_that_cannot_be_used_is_an_error_of_check_and_serve(
    target: str, reason: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_plant(tmp_path, PLANT.partition("[gateway.toy]")[0])
    monkeypatch.setenv("PYTHONPATH", str(other_package(tmp_path / "packages", "broken-gateway", target)))
    done = command(word, str(file))
    text = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == 2 and "Traceback" not in text
    assert reason in text and "reinstall or remove that package" in text


async def test_a_gateway_is_notified_of_a_reload_and_ends_with_its_service(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    events = asyncio.Queue[str]()

    async def serve(client: SocketClient, arguments: Any, ending: asyncio.Event) -> None:
        await ending.wait()
        events.put_nowait("ended")

    with os.fdopen(reading) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        arguments = SimpleNamespace(socket=Path("/missing"))
        task = asyncio.create_task(process._run(arguments, serve, lambda: events.put_nowait("reloaded")))  # type: ignore[arg-type]
        await asyncio.sleep(0)
        os.write(writing, RELOAD_LINE)
        assert await asyncio.wait_for(events.get(), TIMEOUT_S) == "reloaded"
        os.close(writing)
        assert await asyncio.wait_for(events.get(), TIMEOUT_S) == "ended"
        await task


async def test_the_service_notifies_a_gateway_whose_table_did_not_change() -> None:
    script = "import sys; sys.stdin.readline(); sys.exit(sys.stdin.readline() == 'reload\\n')"
    codes = asyncio.Queue[int]()
    started = asyncio.Event()
    child = ChildProcess(
        (sys.executable, "-c", script),
        b"{}\n",
        time.monotonic,
        on_start=lambda pid: started.set(),
        on_exit=lambda code, repeated: codes.put_nowait(code),
    )
    child.notify_reload()
    child.start()
    await started.wait()
    child.notify_reload()
    assert await asyncio.wait_for(codes.get(), TIMEOUT_S) == 1
    await child.close()


PORT_TAKEN_AFTER_FIRST_RUN = """
import errno, pathlib, sys
from drivebus.errors import ConfigurationError
from drivebus.gateways.process import run_gateway

async def serve(client, arguments, ending):
    used = OSError(errno.EADDRINUSE, "used")
    raise ConfigurationError("auth.can_not_listen", host="h", port=1, problem="p") from used

if not pathlib.Path(sys.argv[1]).exists():
    pathlib.Path(sys.argv[1]).touch()
    sys.exit(1)
sys.exit(run_gateway("toy", type(None), serve))
"""


async def test_a_port_that_is_taken_after_a_steady_run_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Every restart counted as a retry: a page that crashed after days and found its port used gave no reason."""
    monkeypatch.setenv("DRIVEBUS_LANG", "en")
    monkeypatch.setattr(gateways, "FIRST_RESTART_PAUSE_S", 0.01)
    script = (sys.executable, "-c", PORT_TAKEN_AFTER_FIRST_RUN, str(tmp_path / "ran"))
    monkeypatch.setattr(gateways, "module_command", lambda module: script)
    config = SimpleNamespace(
        gateways=(GatewayConfig(id="toy", module="toy", settings=None),),
        directory=tmp_path,
        user_file=tmp_path / "users.json",
    )
    first_run_s = iter((0.0, 120.0))
    plant = SimpleNamespace(
        config=config, gateways={}, now=lambda: next(first_run_s, 120.0), publish_event=lambda *_, **__: None
    )
    supervisor = GatewaySupervisor(plant)  # type: ignore[arg-type]
    supervisor.on_reload()
    await wait_until(lambda: plant.gateways["toy"].starts >= 4)
    await supervisor.close()
    assert plant.gateways["toy"].exit_code == ADDRESS_USED_EXIT_CODE
    assert capfd.readouterr().err.count("Can't listen on h:1") == 1


async def test_a_gateway_learns_that_the_plant_had_users_when_the_service_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The state directory is gone when a reload replaces the process: that makes no new plant."""
    monkeypatch.setattr(ChildProcess, "start", lambda child, after=None: None)
    file = tmp_path / "users.json"
    file.touch()
    gateway = GatewayConfig(id="toy", module="toy", settings=None)
    plant = SimpleNamespace(
        config=SimpleNamespace(gateways=(gateway,), directory=tmp_path, user_file=file), gateways={}, now=time.monotonic
    )
    supervisor = GatewaySupervisor(plant)  # type: ignore[arg-type]
    file.unlink()
    supervisor.on_reload()
    assert b'"had_users":true' in supervisor._children["toy"]._arguments


@pytest.mark.parametrize("host", ["plant..local", "nowhere.invalid", "192.0.2.1"])
async def test_a_host_without_an_address_here_neither_ends_the_service_nor_is_called_used(
    host: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The check of the ports raised UnicodeError before any bus was started; what is wrong, the gateway says."""
    gateway = GatewayConfig(id="web", module="drivebus.web", settings=None, listens_at=(host, 8080))
    await report_used_ports(SimpleNamespace(gateways=(gateway,)), ())  # type: ignore[arg-type]
    assert caplog.records == []


async def test_a_reload_notifies_each_gateway_that_it_leaves_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    changes: list[str] = []
    monkeypatch.setattr(ChildProcess, "start", lambda child, after=None: changes.append("start"))
    monkeypatch.setattr(ChildProcess, "notify_reload", lambda child: changes.append("notify"))
    gateway = GatewayConfig(id="toy", module="toy", settings=None)
    plant = SimpleNamespace(
        config=SimpleNamespace(gateways=(gateway,), directory=Path("/state"), user_file=Path("/state/users.json")),
        gateways={},
        now=time.monotonic,
    )
    supervisor = GatewaySupervisor(plant)  # type: ignore[arg-type]
    supervisor.on_reload()
    supervisor.on_reload()
    assert changes == ["start", "notify"]
