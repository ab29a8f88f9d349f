"""drivebus: control and monitor variable-frequency drives of many makes on RS485.

    import asyncio, drivebus

    async def main():
        async with drivebus.open_bus("sim://c320@1", baud=9600, format="8E1") as bus:
            drive = drivebus.Drive(bus, "c320", 1)
            print(await drive.run(25.0, wait=True))
            print((await drive.status()).readings["output_frequency"].value)
            await drive.stop()

    asyncio.run(main())

The names below are public and loaded when they are first used. ``drivebus.blocking`` is the synchronous API.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivebus.bus import Bus, Poll
    from drivebus.drives import (
        Direction,
        Drive,
        DriveLimits,
        DriveState,
        DriveStatus,
        Fault,
        FileStore,
        Outcome,
        OutcomeStatus,
        StopReport,
        stop_all_addresses,
        stop_bus,
    )
    from drivebus.errors import DrivebusError
    from drivebus.serial_settings import SerialSettings
    from drivebus.values import Quality, Reading

_MODULE_OF = {
    "Bus": "bus",
    "Poll": "bus",
    "Direction": "drives",
    "Drive": "drives",
    "DriveLimits": "drives",
    "DriveState": "drives",
    "DriveStatus": "drives",
    "Fault": "drives",
    "FileStore": "drives",
    "Outcome": "drives",
    "OutcomeStatus": "drives",
    "StopReport": "drives",
    "stop_all_addresses": "drives",
    "stop_bus": "drives",
    "DrivebusError": "errors",
    "SerialSettings": "serial_settings",
    "Quality": "values",
    "Reading": "values",
}

__all__ = [
    "Bus",
    "Direction",
    "Drive",
    "DriveLimits",
    "DriveState",
    "DriveStatus",
    "DrivebusError",
    "Fault",
    "FileStore",
    "Outcome",
    "OutcomeStatus",
    "Poll",
    "Quality",
    "Reading",
    "SerialSettings",
    "StopReport",
    "open_bus",
    "stop_all_addresses",
    "stop_bus",
]


def open_bus(url: str, *, baud: int | None = None, format: str | None = None) -> Bus:
    """Return a bus on a port URL (``/dev/ttyUSB0``, ``tcp://host:port``, ``sim://c320@1``), not yet opened.

    Opened by ``async with`` or ``open``. Raises PortUrlError; opening raises PortUnavailable with the remedy.
    """
    from drivebus.bus import Bus
    from drivebus.ports import open_port

    return Bus(open_port(url, baud=baud, format=format))


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
