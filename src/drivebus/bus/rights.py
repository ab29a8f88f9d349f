"""What may be registered and what may be asked at all, checked before anything is queued. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.bus.job import Job
from drivebus.bus.stations import Station
from drivebus.errors import ConfigurationError, NotPermitted
from drivebus.line import LineSettings
from drivebus.message import Ask, Effect, StationLink


def check_address(link: StationLink, stations: Mapping[int, Station]) -> None:
    """Raises ConfigurationError for an address that is taken or is the broadcast address (T10: it never answers)."""
    if link.address in stations:
        raise ConfigurationError("bus.address_taken", address=link.address)
    if link.address == link.codec.broadcast_address:
        raise ConfigurationError("bus.address_broadcast", address=link.address)


def checked_job(ask: Ask, token: Any, stations: Mapping[int, Station], line: LineSettings) -> Job | NotPermitted:
    """The job for an ask, or why it may not be done. Raises ValueError where the request can't be encoded.

    The address in the bytes must be the station that was named: a permit for one drive can't move another.
    """
    station = stations.get(ask.station)
    if station is None:
        speaker = next((one for one in stations.values() if one.codec.broadcast_address == ask.station), None)
        if speaker is None:
            return NotPermitted("bus.unregistered", station=ask.station)
        return _broadcast(Job(ask, token, speaker, line), stations)
    job = Job(ask, token, station, line)
    if job.broadcast:
        return _broadcast(job, stations)
    if job.remembered:
        return job
    spoken_to = station.codec.address_of(ask.request)
    if spoken_to != ask.station:
        return NotPermitted("bus.other_station", station=ask.station, found=spoken_to)
    return job


def _broadcast(job: Job, stations: Mapping[int, Station]) -> Job | NotPermitted:
    """Only a stop is ever broadcast (F10), and it must be a stop to every drive that will hear it.

    The same word may stop one model and start another (2000H of VC660 and DF800).
    """
    for station in stations.values():
        effect = station.link.effect(job.data)
        if effect is not Effect.STOP:
            return NotPermitted("bus.broadcast", station=station.address, effect=effect.value)
    if not job.broadcast:
        return NotPermitted("bus.broadcast_answered", station=job.ask.station)
    return job
