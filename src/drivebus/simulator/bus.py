"""Simulated bus: one wire with its stations and the masters that are attached to it.

The only clock is that of the event loop, so in virtual time every duration is exact. Masters are ``SimPort`` (sim://),
pseudo-terminals and TCP connections; any number of them can share a bus.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import SILENCE_TOLERANCE_S, FrameReceiver, ReceivedFrame
from drivebus.simulator.line_quality import LineQuality, parse_line_quality
from drivebus.simulator.station import SimulatedStation
from drivebus.simulator.timer import LoopTimer
from drivebus.simulator.wire import EPSILON_S, MASTERS, TO_ALL, TO_STATIONS, Transmission, Wire


class BusMaster(Protocol):
    """Master that is attached to a simulated bus."""

    settings: SerialSettings | None
    """Serial settings of the master; None where it has none that could be wrong."""

    def receive(self, data: bytes, line_errors: int) -> None:
        """Take bytes from the wire, ``line_errors`` of them with a parity or framing error."""
        ...

    def on_unplugged(self) -> None:
        """Handle the unplugging of the bus: the master is no longer attached."""
        ...


class StationGroup:
    """Stations with equal framing, which share one frame receiver."""

    __slots__ = ("_broadcast_addresses", "_by_address", "_has_listeners", "receiver", "stations")

    def __init__(self, receiver: FrameReceiver, stations: list[SimulatedStation]) -> None:
        self.receiver = receiver
        self.stations = stations
        self._broadcast_addresses = {station.broadcast for station in stations}
        self._has_listeners = any(
            type(station).on_foreign_frame is not SimulatedStation.on_foreign_frame for station in stations
        )
        self._by_address: dict[int, list[SimulatedStation]] | None = None
        """None where a station may change its address."""
        if not any(station.address_is_parameter for station in stations):
            self._by_address = {}
            for station in stations:
                self._by_address.setdefault(station.address, []).append(station)

    def stations_for(self, address: int) -> list[SimulatedStation]:
        """Return the stations that a frame to this address concerns: all where one handles foreign frames."""
        if self._has_listeners or address in self._broadcast_addresses:
            return self.stations
        if self._by_address is not None:
            return self._by_address.get(address, [])
        return [station for station in self.stations if station.address == address]


class SimulatedBus:
    """Stations on one wire. ``settings`` are those of the stations; the same ``seed`` gives the same noise."""

    def __init__(
        self,
        stations: Iterable[SimulatedStation],
        settings: SerialSettings | None = None,
        *,
        line_quality: LineQuality | str = "clean",
        seed: int = 1,
        name: str = "",
    ) -> None:
        self.stations = list(stations)
        self.settings = settings or (self.stations[0].factory_settings if self.stations else SerialSettings())
        self.name = name
        self.rng = random.Random(seed)
        quality = parse_line_quality(line_quality) if isinstance(line_quality, str) else line_quality
        self.wire = Wire(self.settings, quality, self.rng)
        self.masters: list[BusMaster] = []
        self.on_replug: list[Callable[[], None]] = []
        """Called by ``replug``: servers open their ports again."""
        self.jitter_tolerance_s = SILENCE_TOLERANCE_S
        """Tolerance of measured silences in seconds, higher on ports that the operating system delays."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: LoopTimer | None = None
        self._groups: list[StationGroup] = []
        self._group_stations()

    def station(self, address: int) -> SimulatedStation:
        """Return the first station at an address, at the present time. Raises KeyError."""
        self.advance()
        for station in self.stations:
            if station.address == address:
                return station
        raise KeyError(address)

    def advance(self) -> None:
        """Advance every station to the time of the event loop."""
        now = self.now()
        for station in self.stations:
            station.advance(now)

    def now(self) -> float:
        """Return the time of the running event loop."""
        loop = asyncio.get_running_loop()
        if loop is not self._loop:
            self._switch_loop(loop)
        return loop.time()

    def add(self, station: SimulatedStation) -> None:
        """Add a station; at an address in use, a duplicate."""
        self.stations.append(station)
        self._group_stations()

    @property
    def line_quality(self) -> LineQuality:
        return self.wire.line_quality

    @line_quality.setter
    def line_quality(self, line_quality: LineQuality | str) -> None:
        self.wire.line_quality = parse_line_quality(line_quality) if isinstance(line_quality, str) else line_quality

    def unplug(self) -> None:
        """Unplug the adapter: every master loses its port, bytes on their way are lost, the drives go on."""
        self.wire.plugged = False
        self.wire.discard_pending()
        masters, self.masters = self.masters, []
        for master in masters:
            master.on_unplugged()

    def replug(self) -> None:
        """Plug the adapter in again."""
        self.wire.plugged = True
        for reopen in self.on_replug:
            reopen()

    def attach(self, master: BusMaster) -> None:
        """Attach a master."""
        self.now()
        if self._timer is None:
            assert self._loop is not None
            self._timer = LoopTimer(self._loop, self._deliver_due)
        self.masters.append(master)

    def detach(self, master: BusMaster) -> None:
        """Detach a master. Bytes that it has sent still reach the stations."""
        if master in self.masters:
            self.masters.remove(master)
        self._arm_timer()

    def transmit(self, master: BusMaster, data: bytes) -> None:
        """Transmit bytes of an attached master, one after another from now on."""
        assert self._loop is not None
        sides = TO_ALL if self.wire.line_quality.echo or len(self.masters) > 1 else TO_STATIONS
        # Not ``now``: asking for the running loop costs a system call, a twelfth of a transaction in virtual time.
        self.wire.transmit(master, data, self._loop.time(), sides, master.settings)
        self._arm_timer()

    def _group_stations(self) -> None:
        """Create one frame receiver for all stations with equal framing."""
        groups: dict[Any, list[SimulatedStation]] = {}
        for station in self.stations:
            key = (station.rule, tuple((codec.family, codec.encoding) for codec in station.codecs))
            groups.setdefault(key, []).append(station)
        self._groups = []
        for stations in groups.values():
            first = stations[0]
            receiver = FrameReceiver(first.codecs, first.rule, self.settings, self.jitter_tolerance_s)
            self._groups.append(StationGroup(receiver, stations))
        self.wire.station_delays = tuple(sorted({group.receiver.decision_delay_s for group in self._groups}))

    def set_jitter_tolerance(self, seconds: float) -> None:
        """Set the tolerance of measured silences: real ports are delayed by the operating system."""
        self.jitter_tolerance_s = seconds
        for group in self._groups:
            group.receiver.tolerance_s = seconds

    def _switch_loop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Move to another event loop: the wire is cleared; the drives keep their state, an adapter stays unplugged."""
        was_plugged = self.wire.plugged
        self.wire = Wire(self.settings, self.wire.line_quality, self.rng)
        self.wire.plugged = was_plugged
        self._group_stations()
        self.masters.clear()
        if self._timer is not None:
            self._timer.close()
            self._timer = None
        for station in self.stations:
            station.now = None
        self._loop = loop
        for station in self.stations:
            station.advance(loop.time())

    def _arm_timer(self) -> None:
        """Set the timer to the next event; release it while no master is attached and the wire is silent."""
        if self._timer is None:
            return
        next_at = self.wire.next_event_at()
        if next_at is None and not self.masters:
            self._timer.close()
            self._timer = None
        else:
            self._timer.set(next_at)

    def deliver_pending(self) -> None:
        """Deliver what has arrived by now, before the timer does."""
        assert self._loop is not None
        next_at = self.wire.next_event_at()
        if next_at is not None and next_at <= self._loop.time():
            self._deliver_due()

    def _deliver_due(self) -> None:
        assert self._loop is not None
        now = self._loop.time()
        while (event := self.wire.pop_event(now)) is not None:
            _, _, side, transmission, first, last, decision_delay_s = event
            if side is MASTERS:
                self._deliver_to_masters(transmission, first, last)
            else:
                self._deliver_to_stations(transmission, decision_delay_s, now)
        self._arm_timer()

    def _deliver_to_masters(self, transmission: Transmission, first: int, last: int) -> None:
        data, line_errors = transmission.received(first, last)
        for master in list(self.masters):
            if not data or (master is transmission.source and not self.line_quality.echo):
                continue
            if self.wire.is_foreign(master.settings):
                master.receive(self.rng.randbytes(len(data)), len(data))
            else:
                master.receive(data, line_errors)

    def _deliver_to_stations(self, transmission: Transmission, decision_delay_s: float, now: float) -> None:
        data, line_errors = transmission.received()
        is_silent = self.wire.silent_since(now) <= transmission.end + EPSILON_S
        for group in self._groups:
            receiver = group.receiver
            if receiver.decision_delay_s != decision_delay_s:
                continue
            frames = receiver.feed(data, line_errors, transmission.silence_s)
            if receiver.rule.ends_by_silence and is_silent:
                frames = receiver.on_silence()
            for frame in frames:
                if frame.address is not None:
                    self._dispatch(frame, group.stations_for(frame.address), transmission, now)

    def _dispatch(
        self, frame: ReceivedFrame, stations: list[SimulatedStation], transmission: Transmission, now: float
    ) -> None:
        for station in stations:
            is_broadcast = frame.address == station.broadcast
            if frame.address != station.address and not is_broadcast:
                station.on_foreign_frame(now)
                continue
            station.record_gap(frame.silence_s, short=frame.short_gap)
            reply = station.handle_frame(
                frame.message, frame.codec, self.settings, now, error=frame.error, is_broadcast=is_broadcast
            )
            if reply is not None:
                self.wire.transmit_reply(station, reply.data, now, max(now, transmission.end + reply.delay_s))
