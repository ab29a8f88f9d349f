"""Serial ports of this machine, with identities that survive replugging, and the processes that use them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drivebus.control_characters import without_control_characters
from drivebus.ports import latency_timer, serialx_adapter

PROC = Path("/proc")
BY_ID = Path("/dev/serial/by-id")
BY_PATH = Path("/dev/serial/by-path")


@dataclass(frozen=True, slots=True)
class DeviceUser:
    """A process that has a device open."""

    pid: int
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PortInfo:
    """Serial port of this machine."""

    device: str
    """Present name, such as /dev/ttyUSB0 or COM3."""
    description: str
    identity: str
    """``usb:VID:PID:SERIAL:INTERFACE`` where the adapter has a serial number of its own, else ``path:`` and the socket
    it is plugged into, else ``device:`` and its name."""
    url: str
    """The most stable path for a port URL."""
    users: tuple[DeviceUser, ...] = ()
    """Processes that have it open, as far as this user may see them."""
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None
    latency_ms: int | None = None
    """Time for which the adapter may hold received bytes back (Linux, FTDI), None where it is not known."""


def list_ports() -> list[PortInfo]:
    """Return all ports, with the processes that use them and the latency of their adapters."""
    ports = discover_ports()
    users = device_users({port.device for port in ports})
    return [
        replace(port, users=tuple(users[port.device]), latency_ms=latency_timer.latency_ms(port.device))
        for port in ports
    ]


def discover_ports() -> list[PortInfo]:
    """Return all ports without their users (quick: called at each reopening)."""
    return describe(serialx_adapter.list_devices(), _udev_links(BY_ID), _udev_links(BY_PATH))


def describe(
    devices: Iterable[serialx_adapter.Device], by_id: Mapping[str, str], by_path: Mapping[str, str]
) -> list[PortInfo]:
    """Return the devices of serialx, with the udev links by real device, as ports sorted by name."""
    listed = list(devices)
    count = Counter(_usb_identity(device) for device in listed)
    return sorted(
        (_describe(device, by_id, by_path, unique=count[_usb_identity(device)] == 1) for device in listed),
        key=lambda port: (len(port.device), port.device),
    )


def _describe(
    device: serialx_adapter.Device, by_id: Mapping[str, str], by_path: Mapping[str, str], *, unique: bool
) -> PortInfo:
    name = device.resolved_device
    usb = _usb_identity(device)
    if usb and unique:
        identity, url = usb, by_id.get(name, name)
    elif name in by_path:
        identity, url = f"path:{Path(by_path[name]).name}", by_path[name]
    else:
        identity, url = f"device:{name}", name
    return PortInfo(
        device=name,
        description=_description(device),
        identity=identity,
        url=url,
        vid=device.vid,
        pid=device.pid,
        serial_number=device.serial_number,
    )


def _usb_identity(device: serialx_adapter.Device) -> str:
    """Return the USB identity, empty where the adapter can't be distinguished from others of its kind."""
    if device.vid is None or device.pid is None or not serialx_adapter.has_unique_serial_number(device):
        return ""
    parts = [f"{device.vid:04x}", f"{device.pid:04x}", str(device.serial_number), str(device.interface_num or 0)]
    if device.port_number:
        parts.append(str(device.port_number))
    return "usb:" + ":".join(parts)


def _description(device: serialx_adapter.Device) -> str:
    words = [device.manufacturer, device.product, device.interface_description]
    text = " ".join(dict.fromkeys(word.strip() for word in words if word))
    return without_control_characters(text) or Path(device.resolved_device).name


def _udev_links(folder: Path) -> dict[str, str]:
    """Return udev links by real device."""
    try:
        return {os.path.realpath(link): str(link) for link in sorted(folder.iterdir())}
    except OSError:
        return {}


# --- processes (Linux /proc) -----------------------------------------------------------------------------------------


def device_users(devices: Collection[str]) -> dict[str, list[DeviceUser]]:
    """Return the processes that have each device (real path) open, as far as this user may see them."""
    users: dict[str, list[DeviceUser]] = {device: [] for device in devices}
    for pid in _pids():
        for device in _open_files(pid) & users.keys():
            users[device].append(DeviceUser(pid, process_name(pid)))
    return users


def lock_holder(device: str) -> DeviceUser | None:
    """Return the other process that has locked a device with ``flock``, of any user.

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
    """Return the name of a process, empty where it has ended."""
    try:
        name = (PROC / str(pid) / "comm").read_text(encoding="utf-8", errors="replace").removesuffix("\n")
        return without_control_characters(name).strip()
    except OSError:
        return ""


def pids_named(name: str) -> list[int]:
    """Return the pids of processes of that name, also where /proc hides their open files."""
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
