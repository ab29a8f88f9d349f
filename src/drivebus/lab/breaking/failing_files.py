"""Programs whose files fail at the n-th call: the store of counts, a capture, profiles, sentences (G12, G14)."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

from drivebus import i18n, profiles
from drivebus.capture import read_capture
from drivebus.drives import Drive, FileStore
from drivebus.errors import ConfigurationError, NoReply, ProfileError
from drivebus.lab.breaking.disk import Disk, Killed, installed
from drivebus.lab.breaking.failing_port import BAUD, DONE, HANG_S, LONGEST_S, PortStory
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import VC660
from drivebus.lab.world.loop import running
from drivebus.lab.world.stand import Stand
from drivebus.ports.capturing import CapturingPort

LOADING: Any = import_module("drivebus.profiles.load")
PARAMETER = "F00.02"
SAVES = 3
MODELS = ("c320", "dzb100", "vc660", "df800")
SENTENCE = ("bus.no_reply", "zh")


def store(session: Session, disk: Disk, *, power: bool = False) -> None:
    """Saves that are counted before they are sent: the file is old or new, and no count is lost."""
    path = disk.folder / "state" / "store.json"
    stand = Stand(session, VC660, (1,), name=f"store/{disk.nth}/{disk.error or 'kill'}", baud=BAUD)
    stand.drives[1].close()
    drive = Drive(stand.bus, "vc660", 1, encoding="rtu", store=FileStore(path))
    memory, told = stand.station(1).memory, list[str]()

    async def save(value: float) -> Any:
        before = memory.eeprom_writes.total()
        try:
            return await drive.write({PARAMETER: value}, save=True)
        except ConfigurationError as error:
            told.append(error.key)
            if memory.eeprom_writes.total() > before:
                stand.witness.violation(f"G12 a save was sent, and ended as {error}")
            return None

    def saved(value: float) -> Any:
        wish = stand.wish_by(save, 1, "write", value)
        stand.finish(wish, within_s=LONGEST_S["write"] + HANG_S)
        return wish

    with installed(disk):
        for number in range(SAVES):
            if not disk.dead:
                saved(10.0 + number)
    if disk.dead and power:
        disk.cut()
    _counted(stand, path, memory.eeprom_writes.total())
    if not disk.dead and saved(30.0).word not in DONE:
        stand.witness.violation("G12 the file works again, and nothing is saved")
    session.counts.update(f"store: {key}" for key in told)
    bury(stand) if disk.dead else stand.close()


def bury(stand: Stand) -> None:
    """The program was killed: what it still has in hand never comes to anything."""
    stand.witness.ended = lambda wish: None  # type: ignore[method-assign]
    with running(stand.loop):
        for task in list(stand.loop.tasks):
            task.cancel()
    stand.loop.run_until(stand.loop.time())


def _counted(stand: Stand, path: Path, written: int) -> None:
    """Read without the product's help, then with it."""
    try:
        values = json.loads(path.read_text())["values"] if path.exists() else {}
        counts = sum(json.loads(text)["total"] for name, text in values.items() if name.startswith("wear/"))
    except (ValueError, KeyError) as error:
        stand.witness.violation(f"G12 the store is torn: {error!r}")
        return
    if not written <= counts <= SAVES:
        stand.witness.violation(f"G12 the EEPROM was written {written} times, and {counts} are counted")
    again = FileStore(path)
    again.put("probe", "1")
    if again.get("probe") != "1":
        stand.witness.violation("G12 the store can't be written again")


def capture(session: Session, disk: Disk, clean: list[str], records: list[bytes]) -> None:
    """A recording that fails: the bus goes on as before. The first run fills ``clean`` and ``records``."""
    path, lines = disk.folder / "x.dbcap", list[str]()
    own = Session("failures", session.seed, 1, listener=lines.append)
    recorders, stories = list[CapturingPort](), list[PortStory]()

    def recorded(port: Any) -> CapturingPort:
        recorders.append(CapturingPort(port, path))
        return recorders[0]

    with installed(disk):
        try:
            stories.append(PortStory(own, VC660, "capture", recorded))
            stories[0].live()
            stories[0].stand.close()
        except ConfigurationError as error:
            session.count(f"capture: {error.key}")
            return
        except Killed:
            session.count("capture: killed")
        finally:
            _ended(session, disk, recorders)
    if disk.dead:
        for story in stories:
            bury(story.stand)
    for text in own.violations if not disk.dead else ():
        session.violation(text)
    if not clean:
        clean += lines
        records += path.read_bytes().split(b"\n")
    if not disk.dead and lines != clean:
        session.violation(f"G14 a recording that failed at call {disk.nth} ({disk.failed}) changed what the bus does")
    if disk.failed == "write" and not disk.dead and recorders[0].error is None:
        session.violation(f"G14 a recording ended at call {disk.nth}, and nobody says so")
    _kept(session, disk, path, records)


def _ended(session: Session, disk: Disk, recorders: list[CapturingPort]) -> None:
    try:
        for one in recorders:
            one.end_capture()
    except Killed:
        pass
    except Exception as error:
        session.violation(f"G12 the end of a capture raised {type(error).__name__}: {error}")


def _kept(session: Session, disk: Disk, path: Path, records: list[bytes]) -> None:
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


def profile(session: Session, disk: Disk) -> None:
    """A profile that can't be read is refused with its name; afterwards it is there."""
    for cached in (LOADING._shipped, LOADING._shipped_profile):
        cached.cache_clear()
    with installed(disk):
        for model in MODELS:
            try:
                profiles.load(model)
            except ProfileError as error:
                session.count(f"profiles: refused {error.params.get('file') is not None}")
            except Exception as error:
                session.violation(
                    f"G12 loading {model} with {disk.failed} failing raised {type(error).__name__}: {error}"
                )
    for model in MODELS:
        try:
            profiles.load(model)
        except ProfileError as error:
            session.violation(f"G12 {model} is not there again: {error}")


def sentences(session: Session, disk: Disk) -> None:
    """Whoever tells of an error must not fail at it."""
    right = NoReply(SENTENCE[0], station=3).text(SENTENCE[1])
    i18n.catalogue.cache_clear()
    with installed(disk):
        try:
            told = NoReply(SENTENCE[0], station=3).text(SENTENCE[1])
            session.count(f"sentences: {'told' if told == right else 'told in another way'}")
            if not told:
                session.violation("G12 an error without a word")
        except Exception as error:
            session.violation(f"G12 telling an error with {disk.failed} failing raised {type(error).__name__}: {error}")
    if NoReply(SENTENCE[0], station=3).text(SENTENCE[1]) != right:
        session.violation("G12 the sentences are not there again")


SENTENCES, PROFILES = Path(i18n.__file__).parent, Path(LOADING.__file__).parent / "data"
