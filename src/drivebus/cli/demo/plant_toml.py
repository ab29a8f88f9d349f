"""The ``plant.toml`` of the demo: the same file that anybody would write for such a plant."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from drivebus.cli.demo.layout import LINES, DemoBus, DemoDrive
from drivebus.service.api.errors import localized

FASTEST_S = {"c320": 0.5, "dzb100": 3.0, "vc660": 0.5, "df800": 1.0}
"""No poll more often: three drives share each line."""
GROUPS = ("fan", "pump")


def text(links: Sequence[str], directory: Path, port: int) -> str:
    """The file for these LINKs, in the order of ``LINES``."""
    parts = [
        f'format = 1\n\n[plant]\nid = "demo"\ntitle = {_title("demo.plant")}\ndirectory = {json.dumps(str(directory))}'
    ]
    parts.append(f'[web]\nhost = "127.0.0.1"\nport = {port}')
    for line, link in zip(LINES, links, strict=True):
        parts.append(_bus(line, link))
        parts += [_drive(line, part) for part in line.drives]
    parts += [_group(role) for role in GROUPS]
    parts += [_interlock(), _alarm()]
    return "\n\n".join(parts) + "\n"


def _bus(line: DemoBus, link: str) -> str:
    own = f"[bus.{line.name.lower()}]\nlink = {json.dumps(link)}\ntitle = {_title('demo.bus', bus=line.name)}"
    return f"{own}\nbaud = {line.baud}\nformat = {json.dumps(line.format)}"


def _drive(line: DemoBus, part: DemoDrive) -> str:
    settings = ", ".join(f"{name} = {json.dumps(value)}" for name, value in line.settings.items())
    rows = [
        f"[drive.{part.key}]",
        f'bus = "{line.name.lower()}"',
        f"address = {part.address}",
        f'model = "{line.model}"',
        f"title = {_title(f'demo.role.{part.role}', number=part.number)}",
        f"min_poll_interval_s = {FASTEST_S[line.model]}",
        'on_service_stop = "stop"',
    ]
    return "\n".join([*rows, *([f"settings = {{ {settings} }}"] if settings else [])])


def _group(role: str) -> str:
    keys = [part.key for line in LINES for part in line.drives if part.role == role]
    head = f"[group.{role}s]\ntitle = {_title(f'demo.group.{role}')}\n"
    return f"{head}drives = {json.dumps(keys)}\nstart_interval_s = 2.0\nmax_concurrent_starts = 1"


def _interlock() -> str:
    return (
        f"[interlock.cool]\ntitle = {_title('demo.interlock')}\n"
        'drives = ["spindle-1"]\nrequire = "spindle-1.temperature < 85 °C"\naction = "stop"\ndelay_s = 2.0'
    )


def _alarm() -> str:
    return (
        f"[alarm.hot]\ntitle = {_title('demo.alarm')}\n"
        'kind = "above"\ndrives = ["spindle-1", "spindle-2", "spindle-3"]\nsignal = "temperature"\n'
        'threshold = 70.0\nhysteresis = 5.0\ndelay_s = 5.0\npriority = "high"'
    )


def _title(key: str, **params: object) -> str:
    sides = localized(key, params)
    return "{ " + ", ".join(f"{side} = {json.dumps(said, ensure_ascii=False)}" for side, said in sides.items()) + " }"
