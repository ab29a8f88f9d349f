"""Readings that the tables of the source stations share, by the step of their register."""

from __future__ import annotations

from collections.abc import Callable

from drivebus.simulator.motor import Trip
from verification.source_stations.station import SourceStation

NUMBERED_TRIPS = {trip: number for number, trip in enumerate(Trip, 1)}
"""Numbers of trips where the source gives a range of fault numbers without their meaning."""


def hertz(step_hz: float) -> Callable[[SourceStation], float]:
    """Return the reading of the output frequency."""
    return lambda station: abs(station.displayed_motor.output_hz) / step_hz


def set_hertz(step_hz: float) -> Callable[[SourceStation], float]:
    """Return the reading of the set frequency."""
    return lambda station: station.set_hz / step_hz


def amperes(step_a: float) -> Callable[[SourceStation], float]:
    """Return the reading of the output current."""
    return lambda station: station.displayed_motor.current_a / step_a


def volts(step_v: float) -> Callable[[SourceStation], float]:
    """Return the reading of the output voltage."""
    return lambda station: station.displayed_motor.voltage_v / step_v


def bus_volts(step_v: float) -> Callable[[SourceStation], float]:
    """Return the reading of the DC bus voltage."""
    return lambda station: station.displayed_motor.bus_v / step_v


def rpm(station: SourceStation) -> float:
    return abs(station.displayed_motor.speed_rpm)


def celsius(station: SourceStation) -> float:
    return station.displayed_motor.temperature_c


def fault(station: SourceStation) -> float:
    return station.fault
