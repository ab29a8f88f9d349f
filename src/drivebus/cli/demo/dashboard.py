"""The demo in the browser: the virtual plant under the real service, a shift of history behind it, one address.

Everything lives in a temporary directory and ends with the demo. The story is told as any program would tell it: over
the plant's own socket.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import tempfile
import time
from pathlib import Path
from typing import Any

from drivebus import i18n, profiles
from drivebus.cli import output
from drivebus.cli.demo import plant_toml
from drivebus.cli.demo.history import HOURS, DemoEvent, HistoryGenerator
from drivebus.cli.demo.layout import LINES
from drivebus.cli.demo.plant import DemoPlant, create_demo_plant
from drivebus.cli.errors import ExitCode
from drivebus.clock import wall_ms
from drivebus.drives.store import FileStore
from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.service.api.errors import localized
from drivebus.service.auth.actor import local_actor
from drivebus.service.auth.rights import Role
from drivebus.service.auth.service import AuthService
from drivebus.service.config import load
from drivebus.service.config.model import PlantConfig
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.service.historian import Historian
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET
from drivebus.service.process.logging_setup import configure_logging
from drivebus.service.process.main import run_service

PORT = 8080
CODE_S = 12 * 3600.0
"""The address logs in once; until then it is good for a working day."""
USER = "demo"
PASSWORD_BYTES = 9
"""Made anew each time and printed: the page asks for it after an idle while, and a second browser at once."""
WEB_S = 30.0
SEED = 1
STORY = (
    (2.0, "fan-1", 30.0),
    (3.0, "spindle-1", 50.0),
    (4.0, "conveyor-1", 20.0),
    (5.0, "pump-1", 35.0),
    (7.0, "fan-2", 40.0),
    (9.0, "fan-3", 45.0),
    (11.0, "pump-2", 30.0),
    (13.0, "spindle-2", 40.0),
)
"""Second, drive and frequency of the starts; then one fan trips, and the plant is the user's."""
TRIP_S, TRIPS = 25.0, ("fan-3", 0, 3)


def show(port: int = PORT) -> ExitCode:
    """Until Ctrl-C."""
    configure_logging("text")
    with tempfile.TemporaryDirectory(prefix="drivebus-plant-") as folder:
        directory = Path(folder) / "demo"  # a folder in the temporary one: the audit trail's key lies beside it
        directory.mkdir(mode=0o700)
        return asyncio.run(_demo(directory, port))


async def _demo(directory: Path, port: int) -> ExitCode:
    plant = create_demo_plant()
    await plant.start()
    try:
        file = directory / "plant.toml"
        file.write_text(plant_toml.text(plant.links, directory, free_port(port)), encoding="utf-8")
        setting = load(file)
        code, password = await prepared(setting)
        tasks: list[asyncio.Task[None]] = []

        def begun() -> None:
            tasks.append(asyncio.create_task(_tell(setting, code, password, plant)))

        await run_service(setting, announce="not", on_ready=begun)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        await plant.close()
    return ExitCode.DONE


def free_port(wanted: int) -> int:
    """``wanted``, or any other where somebody listens there already."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            found: int = probe.getsockname()[1]
            return found
    return wanted


async def prepared(setting: PlantConfig) -> tuple[str, str]:
    """History, waivers and a user; returns the code that logs in once, and the user's password."""
    output.print_message("demo.preparing")
    setting.directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    await _history(setting)
    store = FileStore(setting.directory / "plant.json")
    buses = {bus.id: bus for bus in setting.buses}
    for drive in setting.drives:  # simulated motors hurt nobody when this host dies
        store.put(f"waiver/{drive.id}", CommLossWaiver.for_drive(_waiver(), drive, buses[drive.bus]).to_json())
    access = AuthService(setting.directory)
    password = secrets.token_urlsafe(PASSWORD_BYTES)
    user = await access.new_user(USER, Role.ADMINISTRATOR, password)
    await access.change(lambda register: register.with_user(user))
    return await access.issue_code(USER, CODE_S), password


def _waiver() -> str:
    """A reason is one text, as whoever wrote it: the demo's reader has not chosen a language yet."""
    return " · ".join(i18n.text("demo.waiver", side) for side in i18n.LANGUAGES)


async def _history(setting: PlantConfig) -> None:
    start_ms = wall_ms() - int(HOURS * 3_600_000)
    async with Historian(setting.history, setting.directory) as history:
        for line in LINES:
            for part in line.drives:
                shift = HistoryGenerator(line, part, profiles.load(line.model), start_ms, SEED)
                history.append(list(shift.samples()))
                for number, one in enumerate(shift.happened):
                    history.put_event(_marker(one, number))
                await history.flush()


def _marker(one: DemoEvent, number: int) -> dict[str, Any]:
    text = localized(f"demo.{one.kind}", {"name": one.drive, "hz": f"{one.frequency_hz:g}"})
    kind = "fault" if one.kind == "trip" else "command"
    return {
        "id": f"shift-{one.drive}-{number}",
        "time_ms": one.time_ms,
        "kind": kind,
        "drive": one.drive,
        "text": text,
        "actor": "demo",
        "outcome": None,
    }


# --- while it runs ------------------------------------------------------------------------------------------------


async def _tell(setting: PlantConfig, code: str, password: str, plant: DemoPlant) -> None:
    """The address as soon as somebody answers there, however late; the story then, or after a while without."""
    opened = asyncio.create_task(_opened(setting.web.port, code, password))
    client = SocketClient(setting.directory / SERVICE_SOCKET)
    try:
        await asyncio.wait({opened}, timeout=WEB_S)
        if not opened.done():
            output.print_note("demo.web_late", limit_s=f"{WEB_S:g}")
        await _story(client, plant)
        await opened
    finally:
        opened.cancel()
        await client.close()


async def _opened(port: int, code: str, password: str) -> None:
    await _answering(port)
    address = f"http://127.0.0.1:{port}/#login={code}"
    output.print_json({"url": address, "user": USER, "password": password}, stream=True)
    output.print_message("demo.address", url=address, user=USER, password=password)


async def _answering(port: int) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
        else:
            writer.close()
            return


async def _story(client: SocketClient, plant: DemoPlant) -> None:
    """Some drives run, one trips: something to look at. Whoever has taken a drive over keeps it."""
    began = time.monotonic()
    me = local_actor("demo", "demo")

    async def do(operation: str, params: dict[str, Any]) -> None:
        try:
            await client.call(operation, params, me)
        except ServiceUnavailable:
            raise
        except DrivebusError as error:
            output.print_note("demo.failed", name=params["drive"], text=error.text(output.language()))

    async def start(drive: str, frequency_hz: float) -> None:
        await do("drive.run", {"drive": drive, "frequency_hz": frequency_hz})
        await do("lease.release", {"drive": drive})

    for at_s, drive, frequency_hz in STORY:
        await asyncio.sleep(max(0.0, began + at_s - time.monotonic()))
        await start(drive, frequency_hz)
    await asyncio.sleep(max(0.0, began + TRIP_S - time.monotonic()))
    _, line, address = TRIPS
    plant.do({"do": "trip", "line": line, "address": address})
