"""Files whose n-th call fails, and scenarios that run through the failures.

Every call to files under one folder is counted. An error fails one call; a kill ends the program there, with half of a
write done; a power cut also takes back what was not synced. The files are real; only the failure and the loss are
simulated.
"""

from __future__ import annotations

import builtins
import io
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from verification.families.modbus.facts import VC660
from verification.fault_injection.faulty_port import (
    BAUD,
    CALL_MAX_S,
    CALL_TIMEOUT_S,
    PortFailureScenario,
)
from verification.scenario.scenario import Scenario

# --- disk -------------------------------------------------------------------------------------------------------------

REAL_CALLS: dict[str, Any] = {"open": io.open}


class ProgramKilled(BaseException):
    """The simulated program was killed; no handler catches this, and no later call reaches a file."""


class FaultyDisk:
    """Disk whose ``nth`` call fails; 0: calls are only counted.

    ``error`` is raised by the call; None kills the program. ``short``: a write takes half of its bytes and returns
    their number.
    """

    def __init__(self, folder: Path, nth: int = 0, error: Exception | None = None, *, short: bool = False) -> None:
        self.folder, self.nth, self.error, self.short_write = folder, nth, error, short
        self.calls = 0
        self.failed = ""
        """Name of the call that failed."""
        self.is_killed = False
        self._synced: dict[Path, bytes | None] = {}
        """Content of files after a power cut, where it differs from the current content."""
        self._names: dict[int, Path] = {}

    def contains(self, path: Any) -> bool:
        return isinstance(path, str | os.PathLike) and Path(path).is_relative_to(self.folder)

    def count_call(self, what: str) -> bool:
        """Count a call. Raises where it fails; returns True where the program is killed or the write is short."""
        if self.is_killed:
            raise ProgramKilled
        self.calls += 1
        if self.calls != self.nth:
            return False
        self.failed = what
        if self.error is not None:
            raise self.error
        self.is_killed = not self.short_write
        return self.is_killed or what == "write"

    def cut_power(self) -> None:
        """Discard what was not synced."""
        for path, content in self._synced.items():
            if content is None:
                path.unlink(missing_ok=True)
            else:
                path.write_bytes(content)

    # --- replaced functions ----------------------------------------------------------------------------------------

    def open_file(self, file: Any, mode: str = "r", *more: Any, **named: Any) -> Any:
        if not self.contains(file):
            return REAL_CALLS["open"](file, mode, *more, **named)
        path = Path(file)
        if self.count_call(f"open {mode}"):
            raise ProgramKilled
        if "w" in mode:
            self._remember_unsynced(path)
        return _FaultyFile(self, path, REAL_CALLS["open"](path, mode.replace("b", "") + "b", 0), binary="b" in mode)

    def os_open(self, path: Any, flags: int, *more: Any, **named: Any) -> int:
        if not self.contains(path):
            return int(REAL_CALLS["os.open"](path, flags, *more, **named))
        if self.count_call("open"):
            raise ProgramKilled
        if flags & (os.O_EXCL | os.O_TRUNC):
            self._remember_unsynced(Path(path))
        fd = int(REAL_CALLS["os.open"](path, flags, *more, **named))
        self._names[fd] = Path(path)
        return fd

    def os_write(self, fd: int, data: bytes) -> int:
        if fd not in self._names:
            return int(REAL_CALLS["os.write"](fd, data))
        if self.count_call("write"):
            some = int(REAL_CALLS["os.write"](fd, data[: len(data) // 2]))
            if self.short_write:
                return some
            raise ProgramKilled
        return int(REAL_CALLS["os.write"](fd, data))

    def os_close(self, fd: int) -> None:
        known = self._names.pop(fd, None)
        REAL_CALLS["os.close"](fd)
        if known is not None and self.count_call("close"):
            raise ProgramKilled

    def fsync(self, fd: int) -> None:
        """Count the call and remember the content; nothing is synced on the real disk."""
        path = self._names.get(fd)
        if path is None:
            REAL_CALLS["os.fsync"](fd)
            return
        if self.count_call("fsync"):
            raise ProgramKilled
        if path.is_dir():
            self._synced = {file: content for file, content in self._synced.items() if file.parent != path}
        elif path in self._synced:
            self._synced[path] = path.read_bytes()

    def replace(self, old: Any, new: Any, **named: Any) -> None:
        """Replace a file.

        Until the folder is synced, a power cut finds the old file or the synced part of the new one, each for half of
        the calls.
        """
        if not self.contains(new):
            REAL_CALLS["os.replace"](old, new, **named)
            return
        if self.count_call("replace"):
            raise ProgramKilled
        was = self._synced.pop(Path(old), Path(old).read_bytes()) or b""
        before = Path(new).read_bytes() if Path(new).exists() else None
        REAL_CALLS["os.replace"](old, new, **named)
        self._synced[Path(new)] = was if self.nth % 2 else before

    def unlink(self, path: Any, **named: Any) -> None:
        if self.contains(path):
            self.count_call("unlink")
            self._synced.pop(Path(path), None)
        REAL_CALLS["os.unlink"](path, **named)

    def counted(self, name: str) -> Callable[..., Any]:
        """Return a counted form of a call that needs nothing else: mkdir, scandir, listdir, flock."""

        def done(first: Any = ".", *more: Any, **named: Any) -> Any:
            if (self.contains(first) or first in self._names) and self.count_call(name):
                raise ProgramKilled
            return REAL_CALLS[name](first, *more, **named)

        return done

    def _remember_unsynced(self, path: Path) -> None:
        """Remember that a power cut leaves this file empty, or absent if it is new."""
        self._synced.setdefault(path, b"" if path.exists() else None)


class _FaultyFile:
    """Open file, buffered until ``flush`` or ``close``."""

    def __init__(self, disk: FaultyDisk, path: Path, raw: Any, *, binary: bool) -> None:
        self._disk, self._raw, self._binary, self._buffer = disk, raw, binary, b""
        disk._names[raw.fileno()] = path

    def write(self, text: Any) -> int:
        self._buffer += text if self._binary else text.encode()
        return len(text)

    def flush(self) -> None:
        data, self._buffer = self._buffer, b""
        if self._disk.count_call("write"):
            self._raw.write(data[: len(data) // 2])
            raise ProgramKilled
        self._raw.write(data)

    def read(self, size: int = -1) -> Any:
        if self._disk.count_call("read"):
            raise ProgramKilled
        data = self._raw.read(size)
        return data if self._binary else data.decode()

    def fileno(self) -> int:
        return int(self._raw.fileno())

    def close(self) -> None:
        if self._raw.closed:
            return
        try:
            if self._buffer and not self._disk.is_killed:
                self.flush()
        finally:
            self._disk._names.pop(self._raw.fileno(), None)
            self._raw.close()
        if self._disk.count_call("close"):
            raise ProgramKilled

    def __enter__(self) -> _FaultyFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def installed_disk(disk: FaultyDisk) -> Iterator[FaultyDisk]:
    """Route calls to files below the disk's folder through it within the context."""
    places: dict[str, tuple[Any, str, Any]] = {
        "open": (builtins, "open", disk.open_file),
        "io.open": (io, "open", disk.open_file),
        "os.open": (os, "open", disk.os_open),
        "os.write": (os, "write", disk.os_write),
        "os.close": (os, "close", disk.os_close),
        "os.fsync": (os, "fsync", disk.fsync),
        "os.replace": (os, "replace", disk.replace),
        "os.unlink": (os, "unlink", disk.unlink),
        "mkdir": (os, "mkdir", disk.counted("mkdir")),
        "scandir": (os, "scandir", disk.counted("scandir")),
        "listdir": (os, "listdir", disk.counted("listdir")),
    }
    if os.name == "posix":
        import fcntl

        places["flock"] = (fcntl, "flock", disk.counted("flock"))
    REAL_CALLS.update((name, getattr(module, attribute)) for name, (module, attribute, _) in places.items())
    for module, attribute, function in places.values():
        setattr(module, attribute, function)
    try:
        yield disk
    finally:
        for name, (module, attribute, _) in places.items():
            setattr(module, attribute, REAL_CALLS[name])


# --- scenarios --------------------------------------------------------------------------------------------------------

PROFILE_LOADER: Any = import_module("drivebus.profiles.load")
WRITTEN_PARAMETER = "F00.02"
SAVE_COUNT = 3
PROFILE_MODELS = ("c320", "dzb100", "vc660", "df800")
SAMPLE_MESSAGE = ("bus.no_reply", "zh")


def fail_store(campaign_run: CampaignRun, disk: FaultyDisk, *, power: bool = False) -> None:
    """Save parameters through a store whose file fails: the file is old or new, and no save is uncounted."""
    path = disk.folder / "state" / "store.json"
    scenario = Scenario(campaign_run, VC660, (1,), name=f"store/{disk.nth}/{disk.error or 'kill'}", baud=BAUD)
    scenario.drives[1].close()
    drive = Drive(scenario.bus, "vc660", 1, encoding="rtu", store=FileStore(path))
    memory, error_keys = scenario.station(1).memory, list[str]()

    async def save(value: float) -> Any:
        before = memory.eeprom_writes.total()
        try:
            return await drive.write({WRITTEN_PARAMETER: value}, save=True)
        except ConfigurationError as error:
            error_keys.append(error.key)
            if memory.eeprom_writes.total() > before:
                scenario.oracle.violation(f"a save was sent and ended as {error}")
            return None

    def saved(value: float) -> Any:
        command = scenario.command_by(save, 1, "write", value)
        scenario.finish(command, within_s=CALL_MAX_S["write"] + CALL_TIMEOUT_S)
        if disk.is_killed and command.task is not None and command.task.done():
            command.task.exception()  # a killed program logs nothing about its task
        return command

    with installed_disk(disk):
        for number in range(SAVE_COUNT):
            if not disk.is_killed:
                saved(10.0 + number)
    if disk.is_killed and power:
        disk.cut_power()
    _check_count(scenario, path, memory.eeprom_writes.total())
    if not disk.is_killed and not saved(30.0).succeeded:
        scenario.oracle.violation("the file works again and nothing is saved")
    campaign_run.counts.update(f"store: {key}" for key in error_keys)
    discard_killed(scenario) if disk.is_killed else scenario.close()


def discard_killed(scenario: Scenario) -> None:
    """Discard the tasks of a killed program."""
    scenario.oracle.on_command_ended = lambda command: None  # type: ignore[method-assign]
    with running(scenario.loop):
        for task in list(scenario.loop.tasks):
            task.cancel()
    scenario.loop.run_until(scenario.loop.time())


def _check_count(scenario: Scenario, path: Path, written: int) -> None:
    """Check the file of the store: first as JSON, then through the store itself."""
    try:
        values = json.loads(path.read_text())["values"] if path.exists() else {}
        counts = sum(json.loads(text)["total"] for name, text in values.items() if name.startswith("eeprom/"))
    except (ValueError, KeyError) as error:
        scenario.oracle.violation(f"the store is torn: {error!r}")
        return
    if not written <= counts <= SAVE_COUNT:
        scenario.oracle.violation(f"the EEPROM was written {written} times, and {counts} are counted")
    again = FileStore(path)
    again.put("probe", "1")
    if again.get("probe") != "1":
        scenario.oracle.violation("the store cannot be written again")


def fail_capture(campaign_run: CampaignRun, disk: FaultyDisk, clean: list[str], records: list[bytes]) -> None:
    """Record a bus to a failing file; the bus must behave as without the failure.

    The first run fills ``clean`` and ``records``.
    """
    path, lines = disk.folder / "x.dbcap", list[str]()
    own = CampaignRun(campaign="failures", seed=campaign_run.seed, budget=1, listener=lines.append)
    recorders, trials = list[RecordingPort](), list[PortFailureScenario]()

    def recorded(port: Any) -> RecordingPort:
        recorders.append(RecordingPort(port, path))
        return recorders[0]

    with installed_disk(disk):
        try:
            trials.append(PortFailureScenario(own, VC660, "capture", recorded))
            trials[0].run()
            trials[0].scenario.close()
        except ConfigurationError as error:
            campaign_run.count(f"capture: {error.key}")
            return
        except ProgramKilled:
            campaign_run.count("capture: killed")
        finally:
            _check_recording_ended(campaign_run, disk, recorders)
    if disk.is_killed:
        for trial in trials:
            discard_killed(trial.scenario)
    for text in own.violations if not disk.is_killed else ():
        campaign_run.violation(text)
    if not clean:
        clean += lines
        records += path.read_bytes().split(b"\n")
    if not disk.is_killed and lines != clean:
        campaign_run.violation(
            f"a recording that failed at call {disk.nth} ({disk.failed}) changed the behaviour of the bus"
        )
    if disk.failed == "write" and not disk.is_killed and recorders[0].error is None:
        campaign_run.violation(f"a recording ended at call {disk.nth} without a report")
    _check_recorded(campaign_run, disk, path, records)


def _check_recording_ended(campaign_run: CampaignRun, disk: FaultyDisk, recorders: list[RecordingPort]) -> None:
    try:
        for recorder in recorders:
            recorder.end_capture()
    except ProgramKilled:
        pass
    except Exception as error:
        campaign_run.violation(f"the end of a capture raised {type(error).__name__}: {error}")


def _check_recorded(campaign_run: CampaignRun, disk: FaultyDisk, path: Path, records: list[bytes]) -> None:
    """Check that the records from before the failure are in the file and can be read."""
    if not path.exists():
        return
    there = path.read_bytes().split(b"\n")
    if there[1:-1] != records[1 : len(there) - 1]:
        campaign_run.violation(f"the capture that failed at call {disk.nth} differs from the received bytes")
    if len(there) > 1:
        found = read_capture(path)
        if len(found.records) != len(there) - 2:
            campaign_run.violation(f"{len(found.records)} of {len(there) - 2} records can be read")


def fail_profile(campaign_run: CampaignRun, disk: FaultyDisk) -> None:
    """Load profiles from failing files: an unreadable profile is rejected with its name, and loads afterwards."""
    for cached in (PROFILE_LOADER._builtin_files, PROFILE_LOADER._builtin_profile):
        cached.cache_clear()
    with installed_disk(disk):
        for model in PROFILE_MODELS:
            try:
                profiles.load(model)
            except ProfileError as error:
                campaign_run.count(f"profiles: refused {error.params.get('file') is not None}")
            except Exception as error:
                campaign_run.violation(
                    f"loading {model} with {disk.failed} failing raised {type(error).__name__}: {error}"
                )
    for model in PROFILE_MODELS:
        try:
            profiles.load(model)
        except ProfileError as error:
            campaign_run.violation(f"{model} cannot be loaded again: {error}")


def fail_catalogue(campaign_run: CampaignRun, disk: FaultyDisk) -> None:
    """Format an error message while the catalogue's files fail."""
    right = NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1])
    i18n.catalogue.cache_clear()
    with installed_disk(disk):
        try:
            message = NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1])
            campaign_run.count(f"messages: {'complete' if message == right else 'fallback'}")
            if not message:
                campaign_run.violation("an error without a text")
        except Exception as error:
            campaign_run.violation(
                f"formatting an error with {disk.failed} failing raised {type(error).__name__}: {error}"
            )
    if NoReply(SAMPLE_MESSAGE[0], station=3).text(SAMPLE_MESSAGE[1]) != right:
        campaign_run.violation("the messages cannot be loaded again")


SENTENCES, PROFILES = Path(i18n.__file__).parent, Path(PROFILE_LOADER.__file__).parent / "data"
