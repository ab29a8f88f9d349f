"""What may be registered and what may be asked at all, checked before anything is queued. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import Station
from drivebus.errors import ConfigurationError, NotPermitted
from drivebus.protocols.codec import BusRequest, Effect, StationConfig
from drivebus.serial_settings import SerialSettings


def check_new_address(link: StationConfig, stations: Mapping[int, Station]) -> None:
    """Raises ConfigurationError for an address that is taken or is the broadcast address (T10: it never answers)."""
    if link.address in stations:
        raise ConfigurationError("bus.address_taken", address=link.address)
    if link.address == link.codec.broadcast_address:
        raise ConfigurationError("bus.address_broadcast", address=link.address)


def validate_request(
    bus_request: BusRequest, token: Any, stations: Mapping[int, Station], settings: SerialSettings
) -> PreparedRequest | NotPermitted:
    """The job for an ask, or why it may not be done. Raises ValueError where the request can't be encoded.

    The address in the bytes must be the station that was named: a permit for one drive can't move another.
    """
    station = stations.get(bus_request.station)
    if station is None:
        speaker = next((one for one in stations.values() if one.codec.broadcast_address == bus_request.station), None)
        if speaker is None:
            return NotPermitted("bus.unregistered", station=bus_request.station)
        return _validate_broadcast(PreparedRequest(bus_request, token, speaker, settings), stations)
    job = PreparedRequest(bus_request, token, station, settings)
    if job.is_broadcast:
        return _validate_broadcast(job, stations)
    if job.cacheable:
        return job
    spoken_to = station.codec.address_of(bus_request.request)
    if spoken_to != bus_request.station:
        return NotPermitted("bus.other_station", station=bus_request.station, found=spoken_to)
    return job


def _validate_broadcast(job: PreparedRequest, stations: Mapping[int, Station]) -> PreparedRequest | NotPermitted:
    """Only a stop is ever broadcast (F10), and it must be a stop to every drive that will hear it.

    The same word may stop one model and start another (2000H of VC660 and DF800).
    """
    for station in stations.values():
        effect = station.config.effect_of(job.data)
        if effect is not Effect.STOP:
            return NotPermitted("bus.broadcast", station=station.address, effect=effect.value)
    if not job.is_broadcast:
        return NotPermitted("bus.broadcast_answered", station=job.bus_request.station)
    return job
