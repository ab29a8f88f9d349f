"""``ports``: the serial ports of this machine."""

from __future__ import annotations

from typing import Any

from drivebus.cli import voice
from drivebus.cli.command import Verb


def _ports() -> None:
    from drivebus import ports

    found = [_row(port) for port in ports.list_ports()]
    voice.document({"ports": found})
    if found:
        voice.show(_table(found))
    else:
        voice.tell("cli.no_ports")


def _row(port: Any) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(port)


def _table(found: list[dict[str, Any]]) -> str:
    from drivebus.cli.layout import table

    names = list(found[0])
    return table(
        [name.upper() for name in names], [["" if v is None else str(v) for v in row.values()] for row in found]
    )


command = Verb("ports", callback=_ports, examples=("drivebus ports", "drivebus ports --json"))
