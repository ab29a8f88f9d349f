"""The ``plant.toml`` of the demo."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from drivebus.cli.demo.layout import BUSES, DemoBus, DemoDrive
from drivebus.service.api.errors import localized
from drivebus.simulator.models.c320 import FAULT_CODES
from drivebus.simulator.motor import Trip
from drivebus.types import Json

MIN_POLL_INTERVAL_S = {"c320": 0.5, "dzb100": 3.0, "vc660": 0.5, "df800": 1.0}  # three drives share each bus
GROUPS = ("fan", "pump")
FAULT_PROFILE = "c320-of-the-demo.toml"
"""File name of the profile with the texts of the script's trip: the maker's own are not published."""


def fault_profile_toml() -> str:
    """Return the profile of the drives that the script trips: a C320 whose fault has a text, a cause and a remedy."""
    code = FAULT_CODES[Trip.OVERCURRENT_RUNNING]
    texts = "\n".join(f"{name} = {_title(f'demo.fault.{name}')}" for name in ("text", "cause", "remedy"))
    head = f'format = 1\nextends = "c320"\n\n[faults.{code}]\nlabel = "Fu.{code}"'
    return f'{head}\n{texts}\nevidence = "user, the demo itself"\n'


def plant_toml(urls: Sequence[str], directory: Path, port: int, login_notice: Json | None = None) -> str:
    """Return the file for these port URLs, in the order of ``BUSES``."""
    parts = [
        f'format = 1\n\n[plant]\nid = "demo"\ntitle = {_title("demo.plant")}\ndirectory = {json.dumps(str(directory))}'
    ]
    notice = f"\nlogin_notice = {_toml_texts(login_notice)}" if login_notice else ""
    parts.append(f'[gateway.web]\nhost = "127.0.0.1"\nport = {port}{notice}')
    for bus, url in zip(BUSES, urls, strict=True):
        parts.append(_bus(bus, url))
        model = str(directory / FAULT_PROFILE) if bus.model == "c320" else bus.model
        parts += [_drive(bus, drive, model) for drive in bus.drives]
    parts += [_group(role) for role in GROUPS]
    parts += [_interlock(), _alarm()]
    return "\n\n".join(parts) + "\n"


def _bus(bus: DemoBus, url: str) -> str:
    head = f"[bus.{bus.name.lower()}]\nport = {json.dumps(url)}\ntitle = {_title('demo.bus', bus=bus.name)}"
    return f"{head}\nbaud = {bus.baud}\nformat = {json.dumps(bus.format)}"


def _drive(bus: DemoBus, drive: DemoDrive, model: str) -> str:
    known = {**bus.options, **bus.stated_options}
    options = ", ".join(f"{name} = {json.dumps(value)}" for name, value in known.items())
    rows = [
        f"[drive.{drive.key}]",
        f'bus = "{bus.name.lower()}"',
        f"address = {drive.address}",
        f"model = {json.dumps(model)}",
        f"title = {_title(f'demo.role.{drive.role}', number=drive.number)}",
        f"min_poll_interval_s = {MIN_POLL_INTERVAL_S[bus.model]}",
        'on_service_stop = "stop"',
    ]
    return "\n".join([*rows, *([f"options = {{ {options} }}"] if options else [])])


def _group(role: str) -> str:
    keys = [drive.key for bus in BUSES for drive in bus.drives if drive.role == role]
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
    return _toml_texts(localized(key, params))


def _toml_texts(texts: Json) -> str:
    return (
        "{ "
        + ", ".join(f"{language} = {json.dumps(text, ensure_ascii=False)}" for language, text in texts.items())
        + " }"
    )
