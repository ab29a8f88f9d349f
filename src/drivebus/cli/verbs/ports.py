"""``ports``: the serial ports of this machine, and who holds them."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from drivebus.cli import voice
from drivebus.cli.command import Verb

if TYPE_CHECKING:
    from drivebus.ports.listing import PortInfo


def _ports() -> None:
    from drivebus import ports

    found = ports.list_ports()
    voice.document({"ports": [asdict(port) for port in found]})
    if found:
        voice.show(table_of(found))
    else:
        voice.tell("ports_verb.none")


def table_of(found: list[PortInfo]) -> str:
    """One row a port."""
    head = [voice.say(f"ports_verb.{name}") for name in ("device", "description", "link", "held")]
    return voice.grid(head, [[port.device, port.description, port.link, _held(port)] for port in found])


def _held(port: PortInfo) -> str:
    held = ", ".join(f"{holder.name} ({holder.pid})" for holder in port.holders)
    return held or voice.say("ports_verb.free" if _may_open(port.device) else "ports_verb.forbidden")


def _may_open(device: str) -> bool:
    """False where this user has no permission; a Windows name is no path and has none to lack."""
    return not Path(device).exists() or os.access(device, os.R_OK | os.W_OK)


command = Verb("ports", callback=_ports, examples=("drivebus ports", "drivebus ports --json"))
