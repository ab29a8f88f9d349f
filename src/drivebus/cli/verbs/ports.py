"""``ports``: the serial ports of this machine, and who holds them."""

from __future__ import annotations

from dataclasses import asdict
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
    return ", ".join(f"{holder.name} ({holder.pid})" for holder in port.holders) or voice.say("ports_verb.free")


command = Verb("ports", callback=_ports, examples=("drivebus ports", "drivebus ports --json"))
