"""The serial ports of this machine, each with a name that survives replugging and renumbering (F12)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drivebus.ports import serialx_adapter
from drivebus.ports.device_users import DeviceUser, device_users

BY_ID = Path("/dev/serial/by-id")
BY_PATH = Path("/dev/serial/by-path")


@dataclass(frozen=True, slots=True)
class PortInfo:
    """One serial port."""

    device: str
    """Its name today, such as /dev/ttyUSB0 or COM3."""
    description: str
    identity: str
    """``usb:VID:PID:SERIAL:INTERFACE`` where the adapter has a serial number of its own, else ``path:`` the socket it
    is plugged into, else ``device:`` its name."""
    url: str
    """The steadiest path to name it by in a LINK."""
    users: tuple[DeviceUser, ...] = ()
    """Who has it open, as far as this user may see."""
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None


def list_ports() -> list[PortInfo]:
    """All ports, with who holds them."""
    ports = discover_ports()
    held = device_users({port.device for port in ports})
    return [replace(port, users=tuple(held[port.device])) for port in ports]


def discover_ports() -> list[PortInfo]:
    """All ports, without the look at who holds them (quick: used at each reopening)."""
    return describe(serialx_adapter.list_devices(), _udev_links(BY_ID), _udev_links(BY_PATH))


def describe(
    devices: Iterable[serialx_adapter.Device], by_id: Mapping[str, str], by_path: Mapping[str, str]
) -> list[PortInfo]:
    """Pure: what serialx lists, and the udev links by real device, as ports sorted by name."""
    found = list(devices)
    twins = Counter(_usb_identity(device) for device in found)
    return sorted(
        (_describe(device, by_id, by_path, twins[_usb_identity(device)] == 1) for device in found),
        key=lambda port: (len(port.device), port.device),
    )


def _describe(
    device: serialx_adapter.Device, by_id: Mapping[str, str], by_path: Mapping[str, str], unique: bool
) -> PortInfo:
    name = device.resolved_device
    usb = _usb_identity(device)
    if usb and unique:
        identity, link = usb, by_id.get(name, name)
    elif name in by_path:
        identity, link = f"path:{Path(by_path[name]).name}", by_path[name]
    else:
        identity, link = f"device:{name}", name
    return PortInfo(name, _description(device), identity, link, (), device.vid, device.pid, device.serial_number)


def _usb_identity(device: serialx_adapter.Device) -> str:
    """Empty where the adapter can't be told from its twins."""
    if device.vid is None or device.pid is None or not serialx_adapter.has_unique_serial_number(device):
        return ""
    parts = [f"{device.vid:04x}", f"{device.pid:04x}", str(device.serial_number), str(device.interface_num or 0)]
    if device.port_number:
        parts.append(str(device.port_number))
    return "usb:" + ":".join(parts)


def _description(device: serialx_adapter.Device) -> str:
    words = [device.manufacturer, device.product, device.interface_description]
    return " ".join(dict.fromkeys(word.strip() for word in words if word)) or Path(device.resolved_device).name


def _udev_links(folder: Path) -> dict[str, str]:
    """Real device → udev link."""
    try:
        return {os.path.realpath(link): str(link) for link in sorted(folder.iterdir())}
    except OSError:
        return {}
