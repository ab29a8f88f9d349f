"""Registry of the stations on a bus: which may join it, and what a removed one leaves to its successor."""

from __future__ import annotations

from collections.abc import Iterable

from drivebus.bus.compatibility import check_compatible
from drivebus.bus.messages import StationConfig
from drivebus.bus.station import Station
from drivebus.errors import ConfigurationError
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import ANY_REPLY_LATENESS_S, SerialSettings


class StationRegistry:
    """Registered stations by address, and the start inhibit of all."""

    __slots__ = ("_allow_mixed", "_settings", "all_starts_inhibited", "removed", "stations")

    def __init__(self, settings: SerialSettings, *, allow_mixed: bool) -> None:
        """``allow_mixed``: stations of different protocols may share the bus where no frame can be mistaken."""
        self._settings, self._allow_mixed = settings, allow_mixed
        self.stations: dict[int, Station] = {}
        self.all_starts_inhibited = False
        """Whether a station that is registered from now on is start-inhibited too."""
        self.removed: dict[int, Station] = {}
        """Removed stations; one that is registered again inherits its stop epoch and start inhibit from here."""

    def add(self, config: StationConfig) -> None:
        """Register a station. Raises ConfigurationError: address taken or broadcast, or protocols that must not mix.

        Raises ValueError for a sync request that does more than read, or a lateness above ``ANY_REPLY_LATENESS_S``.
        """
        address = config.address
        if address in self.stations:
            raise ConfigurationError("bus.address_taken", address=address)
        if address == config.codec.broadcast_address:
            raise ConfigurationError("bus.address_broadcast", address=address)
        others = (station.config for station in self.stations.values())
        check_compatible(config, others, allow_mixed=self._allow_mixed)
        effect = config.effect_of(config.codec.encode_request(config.sync_request(0)))
        if effect is not Effect.NONE:
            raise ValueError(f"station {address}: a sync request only reads, this one is {effect.value}")
        if config.timing.max_reply_lateness_s > ANY_REPLY_LATENESS_S:
            raise ValueError(f"station {address}: no reply may be later than {ANY_REPLY_LATENESS_S} s")
        station = self.stations[address] = Station(config, self._settings)
        station.start_inhibited = self.all_starts_inhibited
        if address in self.removed:
            station.inherit(self.removed[address])

    def remove(self, address: int) -> Station:
        """Remove and return a station; every permit granted for it is void. Raises KeyError."""
        station = self.removed[address] = self.stations.pop(address)
        station.stop_epoch += 1
        return station

    def set_start_inhibit(self, addresses: Iterable[int] | None, *, inhibited: bool) -> None:
        """Inhibit or allow motion of these stations (None: all, also those registered later). Raises KeyError."""
        if addresses is None:
            self.all_starts_inhibited = inhibited
            for station in self.removed.values():
                station.start_inhibited = inhibited
        for address in self.stations if addresses is None else addresses:
            self.stations[address].start_inhibited = inhibited
