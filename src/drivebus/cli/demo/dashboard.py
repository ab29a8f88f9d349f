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
from drivebus.cli import voice
from drivebus.cli.demo import plantfile
from drivebus.cli.demo.layout import LINES
from drivebus.cli.demo.plant import Plant, make_plant
from drivebus.cli.demo.shift import HOURS, Happening, Shift
from drivebus.cli.exits import Exit
from drivebus.drives.store import FileStore
from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.plant.access.access import Access
from drivebus.plant.access.rights import Role
from drivebus.plant.actor import local
from drivebus.plant.config import load
from drivebus.plant.failure import both
from drivebus.plant.historian import Historian
from drivebus.plant.logs import begin
from drivebus.plant.model import PlantSetting
from drivebus.plant.process import run
from drivebus.plant.socket_client import SocketClient
from drivebus.plant.socket_paths import PLANT
from drivebus.plant.waivers import Waiver
from drivebus.seams import wall_ms

PORT = 8080
CODE_S = 12 * 3600.0
"""The address logs in once; until then it is good for a working day."""
USER = "demo"
PASSWORD_BYTES = 9
"""Made anew each time and printed: the page asks for it after an idle while, and a second browser at once."""
WEB_S = 30.0
SEED = 1
STORY = (
    (2.0, "fan-1", 30.0), (3.0, "spindle-1", 50.0), (4.0, "conveyor-1", 20.0), (5.0, "pump-1", 35.0),
    (7.0, "fan-2", 40.0), (9.0, "fan-3", 45.0), (11.0, "pump-2", 30.0), (13.0, "spindle-2", 40.0),
)  # fmt: skip
"""Second, drive and frequency of the starts; then one fan trips, and the plant is the user's."""
TRIP_S, TRIPS = 25.0, ("fan-3", 0, 3)


def show(port: int = PORT) -> Exit:
    """Until Ctrl-C."""
    begin("text")
    with tempfile.TemporaryDirectory(prefix="drivebus-plant-") as folder:
        directory = Path(folder) / "demo"  # a folder in the temporary one: the audit trail's key lies beside it
        directory.mkdir(mode=0o700)
        return asyncio.run(_demo(directory, port))


async def _demo(directory: Path, port: int) -> Exit:
    plant = make_plant()
    await plant.start()
    try:
        file = directory / "plant.toml"
        file.write_text(plantfile.text(plant.links, directory, free_port(port)), encoding="utf-8")
        setting = load(file)
        code, password = await prepared(setting)
        tasks: list[asyncio.Task[None]] = []

        def begun() -> None:
            tasks.append(asyncio.create_task(_tell(setting, code, password, plant)))

        await run(setting, announce="not", ready=begun)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        await plant.close()
    return Exit.DONE


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


async def prepared(setting: PlantSetting) -> tuple[str, str]:
    """History, waivers and a user; returns the code that logs in once, and the user's password."""
    voice.tell("demo.preparing")
    setting.directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    await _history(setting)
    store = FileStore(setting.directory / "plant.json")
    buses = {bus.id: bus for bus in setting.buses}
    for drive in setting.drives:  # simulated motors hurt nobody when this host dies
        store.put(f"waiver/{drive.id}", Waiver.of(_waiver(), drive, buses[drive.bus]).to_keep())
    access = Access(setting.directory)
    password = secrets.token_urlsafe(PASSWORD_BYTES)
    user = await access.made(USER, Role.ADMINISTRATOR, password)
    await access.change(lambda register: register.added(user))
    return await access.issue_code(USER, CODE_S), password


def _waiver() -> str:
    """A reason is one text, as whoever wrote it: the demo's reader has not chosen a language yet."""
    return " · ".join(i18n.text("demo.waiver", side) for side in i18n.LANGUAGES)


async def _history(setting: PlantSetting) -> None:
    start_ms = wall_ms() - int(HOURS * 3_600_000)
    async with Historian(setting.history, setting.directory) as history:
        for line in LINES:
            for part in line.drives:
                shift = Shift(line, part, profiles.load(line.model), start_ms, SEED)
                history.append(list(shift.samples()))
                for number, one in enumerate(shift.happened):
                    history.put_event(_marker(one, number))
                await history.flush()


def _marker(one: Happening, number: int) -> dict[str, Any]:
    text = both(f"demo.{one.kind}", {"name": one.drive, "hz": f"{one.frequency_hz:g}"})
    kind = "fault" if one.kind == "trip" else "command"
    return {
        "id": f"shift-{one.drive}-{number}", "time_ms": one.time_ms, "kind": kind, "drive": one.drive, "text": text,
        "actor": "demo", "outcome": None,
    }  # fmt: skip


# --- while it runs ------------------------------------------------------------------------------------------------


async def _tell(setting: PlantSetting, code: str, password: str, plant: Plant) -> None:
    """The address as soon as somebody answers there, however late; the story then, or after a while without."""
    opened = asyncio.create_task(_opened(setting.web.port, code, password))
    client = SocketClient(setting.directory / PLANT)
    try:
        await asyncio.wait({opened}, timeout=WEB_S)
        if not opened.done():
            voice.note("demo.web_late", limit_s=f"{WEB_S:g}")
        await _story(client, plant)
        await opened
    finally:
        opened.cancel()
        await client.close()


async def _opened(port: int, code: str, password: str) -> None:
    await _answering(port)
    address = f"http://127.0.0.1:{port}/#login={code}"
    voice.document({"url": address, "user": USER, "password": password}, stream=True)
    voice.tell("demo.address", url=address, user=USER, password=password)


async def _answering(port: int) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
        else:
            writer.close()
            return


async def _story(client: SocketClient, plant: Plant) -> None:
    """Some drives run, one trips: something to look at. Whoever has taken a drive over keeps it."""
    began = time.monotonic()
    me = local("demo", "demo")

    async def do(operation: str, params: dict[str, Any]) -> None:
        try:
            await client.call(operation, params, me)
        except ServiceUnavailable:
            raise
        except DrivebusError as error:
            voice.note("demo.failed", name=params["drive"], text=error.text(voice.language()))

    async def start(drive: str, frequency_hz: float) -> None:
        await do("drive.run", {"drive": drive, "frequency_hz": frequency_hz})
        await do("lease.release", {"drive": drive})

    for at_s, drive, frequency_hz in STORY:
        await asyncio.sleep(max(0.0, began + at_s - time.monotonic()))
        await start(drive, frequency_hz)
    await asyncio.sleep(max(0.0, began + TRIP_S - time.monotonic()))
    _, line, address = TRIPS
    plant.do({"do": "trip", "line": line, "address": address})
