"""``stop<250ms``, ``refresh<2s``, ``load<80%``: what a plant must keep, and who does not keep it. Pure."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from drivebus.plant.config.arithmetic import BusCost

_DEMAND = re.compile(r"\s*(stop|refresh|load)\s*(<=?)\s*([0-9]{1,9}(?:\.[0-9]{1,6})?)\s*(ms|s|%)\s*")
_FACTORS = {"ms": 0.001, "s": 1.0, "%": 1.0}
_BELOW: dict[str, Callable[[float, float], bool]] = {"<": operator.lt, "<=": operator.le}


@dataclass(frozen=True, slots=True)
class Demand:
    """One of them. ``limit`` in seconds, or percent for ``load``."""

    what: str
    sign: str
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A drive (or, for ``load``, a bus) that does not keep a demand. ``found`` is in the unit of the demand's limit."""

    demand: Demand
    name: str
    found: float
    signal: str | None = None


def parse(text: str) -> Demand:
    """Raises ValueError for anything else, a load in seconds included."""
    match = _DEMAND.fullmatch(text)
    if match is None or (match[1] == "load") != (match[4] == "%"):
        raise ValueError(text)
    return Demand(match[1], match[2], float(match[3]) * _FACTORS[match[4]], text.strip())


def shortfalls(demand: Demand, buses: Iterable[BusCost]) -> Iterator[Shortfall]:
    """Everybody who does not keep it."""
    below = _BELOW[demand.sign]
    return (one for bus in buses for one in _measured(demand, bus) if not below(one.found, demand.limit))


def _measured(demand: Demand, bus: BusCost) -> Iterator[Shortfall]:
    if demand.what == "load":
        yield Shortfall(demand, bus.bus, bus.load_percent)
        return
    for drive in bus.drives:
        if demand.what == "stop":
            yield Shortfall(demand, drive.drive, drive.stop_bound_s)
        else:
            signal, refresh_s = drive.slowest
            yield Shortfall(demand, drive.drive, refresh_s, signal)
