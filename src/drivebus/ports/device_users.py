"""Who holds a device open, as far as this user may see it (Linux /proc)."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class DeviceUser:
    """A process that has the device open."""

    pid: int
    name: str


def device_users(devices: Collection[str]) -> dict[str, list[DeviceUser]]:
    """By device (real path): the processes that hold it. Those of other users are invisible to an ordinary user."""
    found: dict[str, list[DeviceUser]] = {device: [] for device in devices}
    for pid in _pids():
        for device in _open_files(pid) & found.keys():
            found[device].append(DeviceUser(pid, process_name(pid)))
    return found


def lock_holder(device: str) -> DeviceUser | None:
    """Who else has locked it with ``flock``: /proc/locks tells everybody, also of other users' processes.

    A process outside this container has no pid here: None.
    """
    try:
        node = Path(device).stat()
        lines = (PROC / "locks").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    file = f"{os.major(node.st_dev):02x}:{os.minor(node.st_dev):02x}:{node.st_ino}"
    for words in map(str.split, lines):
        if len(words) > 5 and words[1] == "FLOCK" and words[5] == file and words[4] not in ("0", str(os.getpid())):
            return DeviceUser(int(words[4]), process_name(int(words[4])))
    return None


def process_name(pid: int) -> str:
    """Its name, or an empty text where it is gone."""
    try:
        return (PROC / str(pid) / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def pids_named(name: str) -> list[int]:
    """Pids of processes of that name: a suspect where /proc hides who holds a device."""
    return [pid for pid in _pids() if process_name(pid) == name]


def _pids() -> Iterator[int]:
    try:
        names = os.listdir(PROC)  # noqa: PTH208  # names only, no Path for each of hundreds
    except OSError:
        return
    yield from sorted(int(name) for name in names if name.isdecimal())


def _open_files(pid: int) -> set[str]:
    folder = f"{PROC}/{pid}/fd"
    targets = set()
    try:
        for name in os.listdir(folder):  # noqa: PTH208
            targets.add(_link_target(f"{folder}/{name}"))
    except OSError:
        return targets
    return targets


def _link_target(link: str) -> str:
    try:
        return os.readlink(link)  # noqa: PTH115  # hot: one call for each open file of the machine
    except OSError:
        return ""
