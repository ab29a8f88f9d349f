"""What one bus knows, how it can be looked at, and how it tells what happened. Decides nothing. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from drivebus.bus import mixed
from drivebus.bus.echo import EchoKeeper
from drivebus.bus.effects import Act, Done, Traced
from drivebus.bus.job import Job
from drivebus.bus.listener import Listener
from drivebus.bus.planner import PollJob
from drivebus.bus.rights import check_address
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.stations import Health, Presence, Station
from drivebus.bus.statistics import Activity, BusStatistics, Counters, snapshot
from drivebus.bus.trace import TraceEvent
from drivebus.bus.transaction import Transaction
from drivebus.line import LineSettings
from drivebus.message import Answer, StationLink


class BusState:
    """One line and its stations. ``paced``: the port's bytes take their character time (ruling 9)."""

    def __init__(
        self,
        line: LineSettings,
        *,
        name: str = "",
        paced: bool = False,
        echo: str = "detect",
        allow_mixed: bool = False,
    ) -> None:
        self.line = line
        self.name = name
        self.paced = paced
        self.tracing = False
        self.is_open = False
        self.begun_at: float | None = None
        """First opened: what is counted counts from here, through every replug."""
        self.opened_at = 0.0
        """Last opened: recent shares look back no further."""
        self.stations: dict[int, Station] = {}
        self.gone: dict[int, Station] = {}
        """Stations that were removed: registered anew, they are no freer than before."""
        self.all_latched = False
        self.scheduler = Scheduler(line)
        self.listener = Listener()
        self.echo = EchoKeeper(echo)
        self.counters = Counters()
        self.activity = Activity()
        self.flight: Transaction | None = None
        self._allow_mixed = allow_mixed
        self.character_s = line.character_s
        self.out: list[Act] = []

    def add(self, link: StationLink) -> None:
        """Register a station. Raises ConfigurationError for an address taken or never answering, or mixed families."""
        check_address(link, self.stations)
        mixed.check(link, (station.link for station in self.stations.values()), self._allow_mixed)
        station = self.stations[link.address] = Station(link, self.line)
        station.latched = self.all_latched
        if link.address in self.gone:
            station.follow(self.gone[link.address])

    def latch(self, addresses: Iterable[int] | None, on: bool) -> None:
        """While latched no frame that may move a motor leaves for these stations (None: all, and who joins later)."""
        if addresses is None:
            self.all_latched = on
            for station in self.gone.values():
                station.latched = on
        for address in self.stations if addresses is None else addresses:
            self.stations[address].latched = on

    def health(self, address: int, now: float) -> Health:
        """Raises KeyError for an address that is not registered."""
        station = self.stations[address]
        failed, damaged, damage_rate = station.counters.window.figures(now)
        return Health(
            self.presence(address), station.suspect, self.listener.foreign_master(now),
            station.duplicate(now), failed, damaged, damage_rate, station.last_heard_at,
        )  # fmt: skip

    def statistics(self, now: float) -> BusStatistics:
        """What this bus has done since it was first opened."""
        stations = {address: station.counters for address, station in self.stations.items()}
        return snapshot(
            self.name, self.counters, self.activity, stations,
            now=now, begun=now if self.begun_at is None else self.begun_at, since=self.opened_at,
            queued=len(self.scheduler), echoes=self.echo.count,
        )  # fmt: skip

    def presence(self, address: int) -> Presence:
        """Raises KeyError for an address that is not registered."""
        found = self.stations[address].presence
        return Presence.SILENT if found is Presence.ONLINE and not self.is_open else found

    def believe(self, station: Station, now: float, *, really: bool) -> None:
        """The station's replies are current again."""
        station.revive(really=really)
        self.scheduler.trusts(station, now)

    def finish(self, job: Job, error: Exception | None, flight: Transaction | None = None) -> None:
        """Tell whoever waits for this job what became of it; nobody waits for a fence."""
        if job.token is None:
            return
        if flight is None:
            sent = job.data if job.attempts else b""  # a repetition that is not sent does not undo what was
            answer = Answer(job.ask, None, error, sent, b"", job.sent_at if sent else None, None, job.attempts)
        else:
            received, message = bytes(flight.buffer), flight.message if error is None else None
            answer = Answer(
                job.ask, message, error, job.data, received, flight.sent_at, flight.heard_at, job.attempts
            )  # fmt: skip
        if isinstance(job, PollJob):
            job.attempts = 0
            if job.cancelled:
                return
        self.out.append(Done(job.token, answer))

    def trace(self, event: TraceEvent) -> None:
        self.out.append(Traced(event))

    def count(self, flight: Transaction, now: float) -> None:
        """The wire was used by both frames, and kept from everybody until now."""
        wire_s = flight.job.send_s + (flight.heard + len(flight.early)) * self.character_s
        counters = flight.job.station.counters
        self.activity.add(now, wire_s, now - flight.sent_at, counters)
        counters.bytes_received += flight.heard
