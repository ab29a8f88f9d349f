"""``ports``: list the serial ports of this machine, and the programs that use them."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from drivebus.cli import output
from drivebus.cli.click_ext import CliCommand

if TYPE_CHECKING:
    from drivebus.ports.discovery import PortInfo


def _ports() -> None:
    from drivebus import ports
    from drivebus.ports import latency_timer

    port_infos = ports.list_ports()
    output.print_json({"ports": [asdict(port) for port in port_infos]})
    if port_infos:
        output.print_text(ports_table(port_infos))
        for port in port_infos:
            if port.latency_ms is not None and port.latency_ms > latency_timer.LOW_LATENCY_MS:
                output.print_note("ports.latency", device=Path(port.device).name, ms=port.latency_ms)
    else:
        output.print_message("ports_command.none")


def ports_table(port_infos: list[PortInfo]) -> str:
    """Format one row per port."""
    head = [output.text(f"ports_command.{name}") for name in ("device", "description", "url", "used_by")]
    return output.fitted_table(head, [[port.device, port.description, port.url, _users(port)] for port in port_infos])


def _users(port: PortInfo) -> str:
    users = output.join((f"{user.name} ({user.pid})" for user in port.users), "items")
    return users or output.text("ports_command.free" if _is_accessible(port.device) else "ports_command.forbidden")


def _is_accessible(device: str) -> bool:
    """Return False if this user lacks permission; a Windows port name is no path and always accessible."""
    return not Path(device).exists() or os.access(device, os.R_OK | os.W_OK)


command = CliCommand("ports", callback=_ports, examples=("drivebus ports", "drivebus ports --json"))
