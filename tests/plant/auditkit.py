"""Trails made by the real writer, with a clock that only counts."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from drivebus.plant.access.rights import RIGHTS, Role
from drivebus.plant.actor import Actor
from drivebus.plant.audit import AuditTrail, Entry
from drivebus.plant.audit.verify import Report, verify

LI = Actor("li", RIGHTS[Role.OPERATOR], "s-1", address="127.0.0.1")


def wall() -> Callable[[], datetime]:
    """A second later each time."""
    now = datetime(2026, 11, 21, tzinfo=UTC)

    def later() -> datetime:
        nonlocal now
        now += timedelta(seconds=1)
        return now

    return later


def trail(folder: Path, **more: Any) -> AuditTrail:
    return AuditTrail(folder / "plant", wall=more.pop("wall", None) or wall(), **more)


def entry(n: int, **more: Any) -> Entry:
    target, params = f"fan-{n % 3}", {"frequency_hz": float(n)}
    return Entry.by(LI, "drive.run", target=target, params=params, outcome="asked", **more)


def written(folder: Path, count: int = 10, **more: Any) -> AuditTrail:
    """``count`` records in all, closed in an orderly way."""

    async def go() -> AuditTrail:
        made = trail(folder, **more)
        await made.open()
        for n in range(2, count + 1):
            await made.record(entry(n))
            if n % 4 == 0:
                await made.checkpoint()
        await made.close()
        return made

    return asyncio.run(go())


def report(made: AuditTrail) -> Report:
    return verify(made.places)


def kinds(made: AuditTrail) -> list[str]:
    return [problem.kind for problem in report(made).problems]
