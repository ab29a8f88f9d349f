"""What one bus knows, how it can be looked at, and how it tells what happened. Decides nothing. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from drivebus.bus import compatibility
from drivebus.bus.commands import CoreCommand, DeliverResult, EmitTrace
from drivebus.bus.echo import EchoDetector
from drivebus.bus.poll_schedule import PreparedPoll
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.station import Presence, Station, StationHealth
from drivebus.bus.statistics import BusStatistics, Counters, RecentActivity, bus_snapshot
from drivebus.bus.trace import TraceEvent
from drivebus.bus.transaction import Transaction
from drivebus.bus.unsolicited import UnsolicitedBytes
from drivebus.bus.validation import check_new_address
from drivebus.protocols.codec import BusResult, StationConfig
from drivebus.serial_settings import SerialSettings


class BusState:
    """One line and its stations. ``paced``: the port's bytes take their character time (ruling 9)."""

    def __init__(
        self,
        settings: SerialSettings,
        *,
        name: str = "",
        has_line_timing: bool = False,
        echo: str = "detect",
        allow_mixed: bool = False,
    ) -> None:
        self.settings = settings
        self.name = name
        self.has_line_timing = has_line_timing
        self.tracing = False
        self.is_open = False
        self.first_opened_at: float | None = None
        """First opened: what is counted counts from here, through every replug."""
        self.opened_at = 0.0
        """Last opened: recent shares look back no further."""
        self.stations: dict[int, Station] = {}
        self.removed_stations: dict[int, Station] = {}
        """Stations that were removed: registered anew, they are no freer than before."""
        self.all_starts_inhibited = False
        self.scheduler = Scheduler(settings)
        self.unsolicited = UnsolicitedBytes()
        self.echo = EchoDetector(echo)
        self.counters = Counters()
        self.activity = RecentActivity()
        self.transaction: Transaction | None = None
        self._allow_mixed = allow_mixed
        self.character_s = settings.character_s
        self.commands: list[CoreCommand] = []

    def add_station(self, link: StationConfig) -> None:
        """Register a station. Raises ConfigurationError for an address taken or never answering, or mixed families."""
        check_new_address(link, self.stations)
        compatibility.check_compatible(link, (station.config for station in self.stations.values()), self._allow_mixed)
        station = self.stations[link.address] = Station(link, self.settings)
        station.start_inhibited = self.all_starts_inhibited
        if link.address in self.removed_stations:
            station.inherit(self.removed_stations[link.address])

    def set_start_inhibit(self, addresses: Iterable[int] | None, inhibited: bool) -> None:
        """While latched no frame that may move a motor leaves for these stations (None: all, and who joins later)."""
        if addresses is None:
            self.all_starts_inhibited = inhibited
            for station in self.removed_stations.values():
                station.start_inhibited = inhibited
        for address in self.stations if addresses is None else addresses:
            self.stations[address].start_inhibited = inhibited

    def health(self, address: int, now: float) -> StationHealth:
        """Raises KeyError for an address that is not registered."""
        station = self.stations[address]
        failed, damaged, damage_rate = station.counters.error_window.rates(now)
        return StationHealth(
            self.presence(address),
            station.suspect,
            self.unsolicited.has_foreign_master(now),
            station.has_duplicate_address(now),
            failed,
            damaged,
            damage_rate,
            station.last_reply_at,
        )

    def statistics(self, now: float) -> BusStatistics:
        """What this bus has done since it was first opened."""
        stations = {address: station.counters for address, station in self.stations.items()}
        return bus_snapshot(
            self.name,
            self.counters,
            self.activity,
            stations,
            now=now,
            first_opened_at=now if self.first_opened_at is None else self.first_opened_at,
            opened_at=self.opened_at,
            queued=len(self.scheduler),
            echoes=self.echo.echo_count,
        )

    def presence(self, address: int) -> Presence:
        """Raises KeyError for an address that is not registered."""
        found = self.stations[address].presence
        return Presence.OFFLINE if found is Presence.ONLINE and not self.is_open else found

    def trust_station(self, station: Station, now: float, *, verified: bool) -> None:
        """The station's replies are current again."""
        station.mark_online(verified=verified)
        self.scheduler.mark_trusted(station, now)

    def complete(self, job: PreparedRequest, error: Exception | None, transaction: Transaction | None = None) -> None:
        """Tell whoever waits for this job what became of it; nobody waits for a fence."""
        if job.token is None:
            return
        if transaction is None:
            sent = job.data if job.attempts else b""  # a repetition that is not sent does not undo what was
            answer = BusResult(
                job.bus_request, None, error, sent, b"", job.sent_at if sent else None, None, job.attempts
            )
        else:
            received, message = bytes(transaction.buffer), transaction.message if error is None else None
            answer = BusResult(
                job.bus_request,
                message,
                error,
                job.data,
                received,
                transaction.sent_at,
                transaction.last_byte_at,
                job.attempts,
            )
        if isinstance(job, PreparedPoll):
            job.attempts = 0
            if job.cancelled:
                return
        self.commands.append(DeliverResult(job.token, answer))

    def trace(self, event: TraceEvent) -> None:
        self.commands.append(EmitTrace(event))

    def record_bus_time(self, transaction: Transaction, now: float) -> None:
        """The wire was used by both frames, and kept from everybody until now."""
        wire_s = (
            transaction.prepared.send_s
            + (transaction.received_count + len(transaction.bytes_before_tx_end)) * self.character_s
        )
        counters = transaction.prepared.station.counters
        self.activity.add(now, wire_s, now - transaction.sent_at, counters)
        counters.bytes_received += transaction.received_count
