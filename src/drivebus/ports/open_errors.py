"""Reasons why a serial port can't be opened, each as one message with the remedy."""

from __future__ import annotations

import errno
import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path

from drivebus.errors import PortUnavailable, SystemReason
from drivebus.ports.discovery import (
    DeviceUser,
    device_users,
    discover_ports,
    lock_holder,
    pids_named,
    process_name,
)

_DEVICE_MISSING_ERRNOS = (errno.ENOENT, errno.ENXIO, errno.ENODEV)
_NOT_SERIAL_ERRNOS = (errno.ENOTTY, errno.EISDIR)
_PORT_GRABBING_SERVICES = ("ModemManager", "brltty")  # open every new port, as root, where /proc hides them from us


def open_error(path: str, error: OSError, owner_pid: int | None = None) -> PortUnavailable:
    """Return the message for an OSError of opening ``path``; ``owner_pid`` of the drivebus that uses it, if known."""
    if error.errno == errno.EBUSY or (sys.platform == "win32" and isinstance(error, PermissionError)):
        return _busy_error(path, owner_pid)
    if isinstance(error, PermissionError):
        return _permission_error(path)
    if isinstance(error, FileNotFoundError) or error.errno in _DEVICE_MISSING_ERRNOS:
        return _missing_error(path)
    if error.errno in _NOT_SERIAL_ERRNOS or not _is_character_device(path):
        return PortUnavailable("ports.not_serial", port=path)
    if error.errno == errno.EIO:
        return PortUnavailable("ports.no_hardware", port=path)
    return PortUnavailable("ports.failed", port=path, reason=SystemReason(error))


def in_use_error(path: str, user: DeviceUser) -> PortUnavailable:
    """Return the message for a device that another program has open."""
    remedies = {"ModemManager": "ports.held_modemmanager", "brltty": "ports.held_brltty"}
    key = "ports.held_getty" if user.name in ("agetty", "getty") else remedies.get(user.name, "ports.held")
    return PortUnavailable(key, port=path, pid=user.pid, name=user.name or "?", device=Path(path).name)


def _busy_error(path: str, owner_pid: int | None) -> PortUnavailable:
    if owner_pid is not None:
        key = "ports.already_open" if owner_pid == os.getpid() else "ports.held_drivebus"
        return PortUnavailable(key, port=path, pid=owner_pid, name=process_name(owner_pid))
    real = os.path.realpath(path)
    others = [user for user in device_users({real})[real] if user.pid != os.getpid()]
    user = lock_holder(real) or next(iter(others), None)
    if user is not None:
        return in_use_error(path, user)
    for name in _PORT_GRABBING_SERVICES:
        for pid in pids_named(name):
            return in_use_error(path, DeviceUser(pid, name))
    return PortUnavailable("ports.busy_windows" if sys.platform == "win32" else "ports.busy", port=path)


def _permission_error(path: str) -> PortUnavailable:
    """Name the group to join: the device's own (dialout on Debian, uucp on Arch), but never root's."""
    if sys.platform == "win32":
        return PortUnavailable("ports.busy_windows", port=path)
    import grp
    import pwd

    try:
        mode, gid = Path(path).stat().st_mode, _group_of(path)
    except OSError as error:  # a directory on the way can't be searched
        return PortUnavailable("ports.failed", port=path, reason=SystemReason(error))
    user = _name_or_default(lambda: pwd.getpwuid(os.getuid()).pw_name, "$USER")
    if gid == 0 or not mode & stat.S_IRGRP or not mode & stat.S_IWGRP:
        return PortUnavailable("ports.permission_rule", port=path, mode=stat.filemode(mode))
    group = _name_or_default(lambda: grp.getgrgid(gid).gr_name, str(gid))
    members = _name_or_default(lambda: " ".join(grp.getgrgid(gid).gr_mem), "").split()
    key = "ports.permission_relogin" if user in members else "ports.permission"
    return PortUnavailable(key, port=path, group=group, user=user)


def _group_of(path: str) -> int:
    return Path(path).stat().st_gid


def _missing_error(path: str) -> PortUnavailable:
    existing = [port.url for port in discover_ports()]
    if existing:
        return PortUnavailable("ports.missing", port=path, existing=tuple(existing))
    return PortUnavailable("ports.missing_wsl" if _in_wsl() else "ports.missing_none", port=path)


def _in_wsl() -> bool:
    try:
        return "microsoft" in Path("/proc/version").read_text(encoding="utf-8", errors="replace").lower()
    except OSError:
        return False


def _is_character_device(path: str) -> bool:
    try:
        return stat.S_ISCHR(Path(path).stat().st_mode)
    except OSError:
        return True


def _name_or_default(look_up: Callable[[], str], default: str) -> str:
    try:
        return look_up()
    except KeyError:
        return default
