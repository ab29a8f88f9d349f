"""What tests of the page do to its plant, and how patient they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivebus.sim.plate import Trip
from pagekit import Stage

PATIENCE_MS = 15_000


def expecting() -> Any:
    """Playwright's ``expect``, as patient as the pages of these tests."""
    from playwright.sync_api import expect

    expect.set_options(timeout=PATIENCE_MS)
    return expect


@contextmanager
def unplugged(stage: Stage, bus: str) -> Iterator[None]:
    """The adapter of a simulated line is pulled for a while."""
    port: Any = stage.service.plant.lines[bus].bus.port
    bench = port.bench

    async def pull() -> None:
        bench.unplug()

    async def put_back() -> None:
        bench.replug()

    stage.do(pull)
    try:
        yield
    finally:
        stage.do(put_back)


def trip(stage: Stage, drive: str) -> None:
    """It has a fault, whether or not it had one before."""
    if stage.view(drive)["fault"] is None:
        stage.station(drive, lambda station: station.trip(Trip.OVERHEAT))
    stage.wait(lambda: stage.view(drive)["fault"] is not None, "no trip")
