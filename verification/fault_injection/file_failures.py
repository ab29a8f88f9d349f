"""Programs whose files fail at the n-th call: the store of counts, a capture, profiles, sentences."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

from drivebus import i18n, profiles
from drivebus.capture.dbcap import read_capture
from drivebus.drives import Drive, FileStore
from drivebus.errors import ConfigurationError, NoReply, ProfileError
from drivebus.ports.recording import RecordingPort
from drivebus.testing.virtual_time import running
from verification.campaign import CampaignRun
from verification.drive_variants import VC660
from verification.fault_injection.faulty_disk import FaultyDisk, ProgramKilled, installed_disk
from verification.fault_injection.port_failures import (
    BAUD,
    CALL_MAX_S,
    CALL_TIMEOUT_S,
    PORT_SUCCESS_WORDS,
    PortFailureScenario,
)
from verification.scenario.scenario import Scenario

PROFILE_LOADER: Any = import_module("drivebus.profiles.load")
WRITTEN_PARAMETER = "F00.02"
SAVE_COUNT = 3
PROFILE_MODELS = ("c320", "dzb100", "vc660", "df800")
SAMPLE_MESSAGE = ("bus.no_reply", "zh")


def fail_store(session: CampaignRun, disk: FaultyDisk, *, power: bool = False) -> None:
    """Saves that are counted before they are sent: the file is old or new, and no count is lost."""
    path = disk.folder / "state" / "store.json"
    stand = Scenario(session, VC660, (1,), name=f"store/{disk.nth}/{disk.error or 'kill'}", baud=BAUD)
    stand.drives[1].close()
    drive = Drive(stand.bus, "vc660", 1, encoding="rtu", store=FileStore(path))
    memory, message = stand.station(1).memory, list[str]()

    async def save(value: float) -> Any:
        before = memory.eeprom_writes.total()
        try:
            return await drive.write({WRITTEN_PARAMETER: value}, save=True)
        except ConfigurationError as error:
            message.append(error.key)
            if memory.eeprom_writes.total() > before:
                stand.oracle.violation(f"G12 a save was sent, and ended as {error}")
            return None

    def saved(value: float) -> Any:
        command = stand.command_by(save, 1, "write", value)
        stand.finish(command, within_s=CALL_MAX_S["write"] + CALL_TIMEOUT_S)
        return command

    with installed_disk(disk):
        for number in range(SAVE_COUNT):
            if not disk.is_killed:
                saved(10.0 + number)
    if disk.is_killed and power:
        disk.cut_power()
    _check_count(stand, path, memory.eeprom_writes.total())
    if not disk.is_killed and saved(30.0).result_word not in PORT_SUCCESS_WORDS:
        stand.oracle.violation("G12 the file works again, and nothing is saved")
    session.counts.update(f"store: {key}" for key in message)
    discard_killed(stand) if disk.is_killed else stand.close()


def discard_killed(stand: Scenario) -> None:
    """The program was killed: what it still has in hand never comes to anything."""
    stand.oracle.on_command_ended = lambda command: None  # type: ignore[method-assign]
    with running(stand.loop):
        for task in list(stand.loop.tasks):
            task.cancel()
    stand.loop.run_until(stand.loop.time())


def _check_count(stand: Scenario, path: Path, written: int) -> None:
    """Read without the product's help, then with it."""
    try:
        values = json.loads(path.read_text())["values"] if path.exists() else {}
        counts = sum(json.loads(text)["total"] for name, text in values.items() if name.startswith("eeprom/"))
    except (ValueError, KeyError) as error:
        stand.oracle.violation(f"G12 the store is torn: {error!r}")
        return
    if not written <= counts <= SAVE_COUNT:
        stand.oracle.violation(f"G12 the EEPROM was written {written} times, and {counts} are counted")
    again = FileStore(path)
    again.put("probe", "1")
    if again.get("probe") != "1":
        stand.oracle.violation("G12 the store can't be written again")


def fail_capture(session: CampaignRun, disk: FaultyDisk, clean: list[str], records: list[bytes]) -> None:
    """A recording that fails: the bus goes on as before. The first run fills ``clean`` and ``records``."""
    path, lines = disk.folder / "x.dbcap", list[str]()
    own = CampaignRun("failures", session.seed, 1, listener=lines.append)
    recorders, stories = list[RecordingPort](), list[PortFailureScenario]()

    def recorded(port: Any) -> RecordingPort:
        recorders.append(RecordingPort(port, path))
        return recorders[0]

    with installed_disk(disk):
        try:
            stories.append(PortFailureScenario(own, VC660, "capture", recorded))
            stories[0].run()
            stories[0].scenario.close()
        except ConfigurationError as error:
            session.count(f"capture: {error.key}")
            return
        except ProgramKilled:
            session.count("capture: killed")
        finally:
            _check_recording_ended(session, disk, recorders)
    if disk.is_killed:
        for story in stories:
            discard_killed(story.scenario)
    for text in own.violations if not disk.is_killed else ():
        session.violation(text)
    if not clean:
        clean += lines
        records += path.read_bytes().split(b"\n")
    if not disk.is_killed and lines != clean:
        session.violation(f"G14 a recording that failed at call {disk.nth} ({disk.failed}) changed what the bus does")
    if disk.failed == "write" and not disk.is_killed and recorders[0].error is None:
        session.violation(f"G14 a recording ended at call {disk.nth}, and nobody says so")
    _check_recorded(session, disk, path, records)


def _check_recording_ended(session: CampaignRun, disk: FaultyDisk, recorders: list[RecordingPort]) -> None:
    try:
        for one in recorders:
            one.end_capture()
    except ProgramKilled:
        pass
    except Exception as error:
        session.violation(f"G12 the end of a capture raised {type(error).__name__}: {error}")


def _check_recorded(session: CampaignRun, disk: FaultyDisk, path: Path, records: list[bytes]) -> None:
    """What was recorded before it failed stands, and can be read."""
    if not path.exists():
        return
    there = path.read_bytes().split(b"\n")
    if there[1:-1] != records[1 : len(there) - 1]:
        session.violation(f"G12 the capture that failed at call {disk.nth} holds something else than was heard")
    if len(there) > 1:
        found = read_capture(path)
        if len(found.records) != len(there) - 2:
            session.violation(f"G12 {len(found.records)} of {len(there) - 2} records can be read")


def fail_profile(session: CampaignRun, disk: FaultyDisk) -> None:
    """A profile that can't be read is refused with its name; afterwards it is there."""
    for cached in (PROFILE_LOADER._builtin_files, PROFILE_LOADER._builtin_profile):
        cached.cache_clear()
    with installed_disk(disk):
        for model in PROFILE_MODELS:
            try:
                profiles.load(model)
            except ProfileError as error:
                session.count(f"profiles: refused {error.params.get('file') is not None}")
            except Exception as error:
                session.violation(
                    f"G12 loading {model} with {disk.failed} failing raised {type(error).__name__}: {error}"
                )
    for model in PROFILE_MODELS:
        try:
            profiles.load(model)
        except ProfileError as error:
            session.violation(f"G12 {model} is not there again: {error}")


def fail_catalogue(session: CampaignRun, disk: FaultyDisk) -> None:
    """Whoever tells of an error must not fail at it."""
    right = NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1])
    i18n.catalogue.cache_clear()
    with installed_disk(disk):
        try:
            message = NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1])
            session.count(f"sentences: {'told' if message == right else 'told in another way'}")
            if not message:
                session.violation("G12 an error without a word")
        except Exception as error:
            session.violation(f"G12 telling an error with {disk.failed} failing raised {type(error).__name__}: {error}")
    if NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1]) != right:
        session.violation("G12 the sentences are not there again")


SENTENCES, PROFILES = Path(i18n.__file__).parent, Path(PROFILE_LOADER.__file__).parent / "data"
