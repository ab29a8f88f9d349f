"""Host of the demo: simulated drives, the service of a real plant, and a script that commands them.

Everything lives in a temporary directory and ends with the demo. The script and the terminal view are clients of the
service's socket.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import signal
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.demo.history import (
    HISTORY_HOURS,
    DemoEvent,
    HistoryGenerator,
    number_alarms,
    past_alarms,
    past_statistics,
    trip_fault,
)
from drivebus.cli.demo.layout import BUSES
from drivebus.cli.demo.plant import DemoPlant, MemoryDemoPlant, create_demo_plant
from drivebus.cli.demo.plant_toml import FAULT_PROFILE, fault_profile_toml, plant_toml
from drivebus.cli.demo.script import (
    END_S,
    OPENING,
    PAGE_CONTINUATION,
    TERMINAL_CONTINUATION,
    ScriptPlayer,
    ScriptStep,
    caption,
)
from drivebus.cli.errors import ExitCode
from drivebus.cli.signals import shutdown_signals
from drivebus.clock import wall_ms
from drivebus.drives.store import FileStore
from drivebus.profiles.model import DriveProfile
from drivebus.service.alarms import Alarm
from drivebus.service.alarms.log import ALARM_LOG_FILE, AlarmLog
from drivebus.service.api.errors import localized
from drivebus.service.app import Service
from drivebus.service.auth.actor import local_actor
from drivebus.service.auth.errors import InvalidInput
from drivebus.service.auth.password_policy import check_password_policy
from drivebus.service.auth.rights import Role
from drivebus.service.auth.service import AuthService
from drivebus.service.config import load, profile_of
from drivebus.service.config.model import PlantConfig
from drivebus.service.control.waivers import CommLossWaiver, waiver_key
from drivebus.service.historian import Historian
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET, socket_path
from drivebus.service.process.logging_setup import configure_logging
from drivebus.service.process.main import run_service
from drivebus.service.runtime.run_statistics import DOCUMENT_KIND
from drivebus.service.storage.settings import SETTINGS_FILE
from drivebus.types import Json
from drivebus.values import Text

LOGIN_CODE_LIFETIME_S = 12 * 3600.0  # the printed address logs in once, during a working day
USER = "demo"
PASSWORD_BYTES = 9  # the password is new each time, printed, and on the login page, which only this computer reaches
LAST_CAPTION_S = 60.0  # the last caption of the script stays this long on the page
PAGE_TIMEOUT_S = 30.0  # after this time a note reports that the page is late
HISTORY_SEED = 1


# --- in the browser -----------------------------------------------------------------------------------------------


def run_demo(port: int) -> ExitCode:
    """Run the demo with its page until Ctrl-C."""
    output.export_language()
    # Its drives and its audit trail end with it: none is left running, and no checkpoint is of use.
    configure_logging("text", without_events=("not_stopped", "checkpoint"))
    return asyncio.run(_run_until_signal(port))


async def _run_until_signal(port: int) -> ExitCode:
    with shutdown_signals() as shutdown, _directory() as directory:
        await shutdown.interruptible(_run_with_page(directory, port))  # the service handles the signals once it runs
    with output.continue_without_output():
        output.end_live_line()  # a terminal shows ^C there
        output.print_message("demo.ended")
    return ExitCode.INTERRUPTED if shutdown.received else ExitCode.DONE


@contextmanager
def _directory() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="drivebus-plant-") as folder:
        directory = Path(folder) / "demo"  # the key of the audit trail lies beside it
        directory.mkdir(mode=0o700)
        yield directory


async def _run_with_page(directory: Path, port: int) -> None:
    plant = create_demo_plant()
    try:
        await plant.start()
        password = draw_password()
        notice = localized("demo.login_notice", {"user": USER, "password": password})
        config = _write_config(plant, directory, free_port(port), notice)
        code = await prepare(config, password)
        tasks: list[asyncio.Task[None]] = []

        def on_ready(service: Service) -> None:
            def show(step: ScriptStep | None) -> None:
                service.plant.notice = None if step is None else caption(step)

            tasks.append(asyncio.create_task(_announce_and_play(config, code, password, plant, show)))

        await run_service(config, address_output="none", on_ready=on_ready, reloads_on_hangup=False)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        await plant.close()


def draw_password() -> str:
    """Return a new password that the password policy accepts: it refuses about one of 5,000 random ones."""
    while True:
        with suppress(InvalidInput):
            return check_password_policy(secrets.token_urlsafe(PASSWORD_BYTES), USER)


def _write_config(plant: DemoPlant, directory: Path, port: int, login_notice: Json | None = None) -> PlantConfig:
    file = directory / "plant.toml"
    (directory / FAULT_PROFILE).write_text(fault_profile_toml(), encoding="utf-8")
    file.write_text(plant_toml(plant.urls, directory, port, login_notice), encoding="utf-8")
    return load(file)


def free_port(preferred: int) -> int:
    """Return ``preferred``, or any free port if it is in use."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            number: int = probe.getsockname()[1]
            return number
    return preferred


async def _announce_and_play(
    config: PlantConfig, code: str, password: str, plant: DemoPlant, show: Callable[[ScriptStep | None], None]
) -> None:
    """Print the address when the page answers; play the script then, or after a timeout.

    ``show`` gets each step for the page, and None when its last caption is old.
    """
    address = asyncio.create_task(_print_address(config.gateway("web").settings.port, code, password))
    try:
        await asyncio.wait({address}, timeout=PAGE_TIMEOUT_S)
        if not address.done():
            output.print_note("demo.web_late", limit_s=f"{PAGE_TIMEOUT_S:g}")
        await _play(config, plant, OPENING + PAGE_CONTINUATION, None, report=lambda message: None, on_step=show)
        await address
        await asyncio.sleep(LAST_CAPTION_S)
        show(None)
    finally:
        address.cancel()


async def _print_address(port: int, code: str, password: str) -> None:
    await _wait_for_page(port)
    address = f"http://127.0.0.1:{port}/#login={code}"
    output.print_json({"url": address, "user": USER, "password": password}, stream=True)
    output.print_message("demo.address", url=address, user=USER, password=password)


async def _wait_for_page(port: int) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
        else:
            writer.close()
            return


async def _play(
    config: PlantConfig,
    plant: DemoPlant,
    steps: tuple[ScriptStep, ...],
    end_s: float | None,
    *,
    report: Callable[[str], None],
    on_player: Callable[[ScriptPlayer], None] = lambda player: None,
    on_step: Callable[[ScriptStep], None] = lambda step: None,
) -> None:
    """Play steps over the socket of the service."""
    client, actor = SocketClient(socket_path(config.directory, SERVICE_SOCKET)), local_actor("demo", "demo")

    async def call(operation: str, params: Json) -> Json:
        return await client.call(operation, params, actor)

    player = ScriptPlayer(call, plant, report, on_step)
    on_player(player)
    try:
        await player.play(steps, end_s)
    finally:
        await client.close()


# --- history, waivers, user ---------------------------------------------------------------------------------------


async def prepare(config: PlantConfig, password: str) -> str:
    """Write history, waivers and a user with this password; return the code that logs in once."""
    output.print_message("demo.preparing")
    config.directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    await _write_history(config)
    _write_waivers(config)
    auth = AuthService(config.directory)
    user = await auth.new_user(USER, Role.ADMINISTRATOR, password)
    await auth.change_database(lambda database: database.with_user(user))
    return await auth.issue_code(USER, LOGIN_CODE_LIFETIME_S)


def _write_waivers(config: PlantConfig) -> None:
    """Allow the start of simulated drives, whose reaction to a communication loss is harmless."""
    store = FileStore(config.directory / SETTINGS_FILE)
    buses = {bus.id: bus for bus in config.buses}
    reason = " · ".join(i18n.text("demo.waiver", language) for language in i18n.LANGUAGES)
    for drive in config.drives:
        store.put(waiver_key(drive.id), CommLossWaiver.for_drive(reason, drive, buses[drive.bus]).to_json())


async def _write_history(config: PlantConfig) -> None:
    """Write samples and events, and the alarms and run statistics that follow from them."""
    start_ms = wall_ms() - int(HISTORY_HOURS * 3_600_000)
    drives = {drive.id: drive for drive in config.drives}
    alarms: list[Alarm] = []
    async with Historian(config.history, config.directory) as historian:
        for bus in BUSES:
            for drive in bus.drives:
                setting = drives[drive.key]
                profile = profile_of(setting)
                generator = HistoryGenerator(bus, drive, profile, start_ms, HISTORY_SEED)
                samples = list(generator.samples())
                await historian.import_samples(samples)
                for number, event in enumerate(generator.events):
                    historian.put_event(_event_json(event, number, setting.title, profile))
                alarms += past_alarms(setting, profile, generator.events, USER)
                statistics = past_statistics(profile, samples, generator.events, start_ms)
                historian.put_document(DOCUMENT_KIND, drive.key, statistics.to_document())
                await historian.flush()
    log = AlarmLog(config.directory / ALARM_LOG_FILE)
    for alarm in number_alarms(alarms):
        log.put(alarm)
    await log.close()


def _event_json(event: DemoEvent, number: int, name: Text, profile: DriveProfile) -> Json:
    text = localized(f"demo.{event.kind}", {"name": name, "hz": f"{event.frequency_hz:g}"})
    if event.kind == "trip":
        fault = trip_fault(profile)
        text = localized("plant.drive_fault", {"label": fault["label"], "fault": Text(**fault["text"])})
    return {
        "id": f"shift-{event.drive}-{number}",
        "time_ms": event.time_ms,
        "kind": "fault" if event.kind == "trip" else "command",
        "drive": event.drive,
        "text": text,
        "actor": "demo",
        "outcome": None,
    }


# --- for the terminal view ----------------------------------------------------------------------------------------


async def serve_terminal(*, memory: bool) -> None:
    """Run the service without its page for a parent process that shows it.

    Prints JSON lines: ``{"socket": …}`` when the service is ready, ``{"message": …}`` for the script, and
    ``{"finished": true}`` at its end. A line on standard input ends the script; its end ends the demo.
    """
    plant = MemoryDemoPlant() if memory else create_demo_plant()
    tasks: list[asyncio.Task[None]] = []
    try:
        await plant.start()
        with _directory() as directory:
            config = _write_config(plant, directory, 8080)
            _write_waivers(config)

            def on_ready(_: Service) -> None:
                tasks.append(asyncio.create_task(_serve_parent(config, plant)))

            await run_service(
                config, without=("web",), address_output="none", on_ready=on_ready, reloads_on_hangup=False
            )
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        await plant.close()


async def _serve_parent(config: PlantConfig, plant: DemoPlant) -> None:
    loop = asyncio.get_running_loop()
    players: list[ScriptPlayer] = []

    def send(message: Json) -> None:
        print(json.dumps(message, ensure_ascii=False), flush=True)

    async def read_parent() -> None:
        while await loop.run_in_executor(None, sys.stdin.readline):
            for player in players:
                player.take_over()
        os.kill(os.getpid(), signal.SIGTERM)

    reading = asyncio.create_task(read_parent())
    send({"socket": str(socket_path(config.directory, SERVICE_SOCKET))})
    await _play(
        config,
        plant,
        OPENING + TERMINAL_CONTINUATION,
        END_S,
        report=lambda text: send({"message": text}),
        on_player=players.append,
    )
    if not players[0].taken_over:
        send({"finished": True})
    await reading


if __name__ == "__main__":
    output.parse_global_options(sys.argv[1:])
    configure_logging("text")
    asyncio.run(serve_terminal(memory="--memory" in sys.argv))
