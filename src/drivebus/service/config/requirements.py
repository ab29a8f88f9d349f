"""``stop<250ms``, ``refresh<2s``, ``load<80%``: what a plant must keep, and who does not keep it. Pure."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from drivebus.service.config.bus_load import BusLoadEstimate

_REQUIREMENT = re.compile(r"\s*(stop|refresh|load)\s*(<=?)\s*([0-9]{1,9}(?:\.[0-9]{1,6})?)\s*(ms|s|%)\s*")
_UNIT_FACTORS = {"ms": 0.001, "s": 1.0, "%": 1.0}
_COMPARISONS: dict[str, Callable[[float, float], bool]] = {"<": operator.lt, "<=": operator.le}


@dataclass(frozen=True, slots=True)
class LoadRequirement:
    """One of them. ``limit`` in seconds, or percent for ``load``."""

    quantity: str
    sign: str
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class RequirementViolation:
    """A drive (or, for ``load``, a bus) that does not keep a demand. ``found`` is in the unit of the demand's limit."""

    requirement: LoadRequirement
    name: str
    found: float
    signal: str | None = None


def parse_requirement(text: str) -> LoadRequirement:
    """Raises ValueError for anything else, a load in seconds included."""
    match = _REQUIREMENT.fullmatch(text)
    if match is None or (match[1] == "load") != (match[4] == "%"):
        raise ValueError(text)
    return LoadRequirement(match[1], match[2], float(match[3]) * _UNIT_FACTORS[match[4]], text.strip())


def violations(demand: LoadRequirement, buses: Iterable[BusLoadEstimate]) -> Iterator[RequirementViolation]:
    """Everybody who does not keep it."""
    below = _COMPARISONS[demand.sign]
    return (one for bus in buses for one in _measurements(demand, bus) if not below(one.found, demand.limit))


def _measurements(demand: LoadRequirement, bus: BusLoadEstimate) -> Iterator[RequirementViolation]:
    if demand.quantity == "load":
        yield RequirementViolation(demand, bus.bus, bus.load_percent)
        return
    for drive in bus.drives:
        if demand.quantity == "stop":
            yield RequirementViolation(demand, drive.drive, drive.stop_bound_s)
        else:
            signal, refresh_s = drive.slowest
            yield RequirementViolation(demand, drive.drive, refresh_s, signal)
