"""A bench: one wire with its stations, and the hosts that are plugged into it. The only clock is the event loop's.

In a virtual loop every duration is exact. Hosts are ``SimPort`` (sim://), ptys and TCP connections; two of them on one
bench are two masters.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FrameReceiver, ReceivedFrame
from drivebus.simulator.line_quality import LineQuality, parse_line_quality
from drivebus.simulator.station import Station
from drivebus.simulator.timer import LoopTimer
from drivebus.simulator.wire import Side, Transmission, Wire


class BusMaster(Protocol):
    """Somebody plugged into the wire."""

    settings: SerialSettings | None
    """The host's own line settings; None where it has none that could be wrong."""

    def receive(self, data: bytes, marks: int) -> None: ...
    def on_unplugged(self) -> None:
        """The bench was unplugged: this host is no longer attached."""
        ...


class SimulatedBus:
    """Stations on one wire. ``line`` is theirs; ``seed`` makes noise repeatable: same seed, same bytes."""

    def __init__(
        self,
        stations: Iterable[Station],
        line: SerialSettings | None = None,
        *,
        weather: LineQuality | str = "clean",
        seed: int = 1,
        name: str = "",
    ) -> None:
        self.stations = list(stations)
        self.settings = line or (self.stations[0].factory_settings if self.stations else SerialSettings())
        self.name = name
        self.rng = random.Random(seed)
        chosen = parse_line_quality(weather) if isinstance(weather, str) else weather
        self.wire = Wire(self.settings, chosen, self.rng)
        self.masters: list[BusMaster] = []
        self.on_replug: list[Callable[[], None]] = []
        """Called by ``replug``: servers put their ports back."""
        self.jitter_tolerance_s = 1e-6
        """By how much a silence may measure short: more on ports that the operating system delays."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: LoopTimer | None = None
        self._groups: list[tuple[FrameReceiver, list[Station]]] = []
        self._group_stations()

    # What a test or a demo does with it.

    def station(self, address: int) -> Station:
        """The (first) station at an address, as it is now. Raises KeyError."""
        self.advance()
        for station in self.stations:
            if station.address == address:
                return station
        raise KeyError(address)

    def advance(self) -> None:
        """Bring every station to the loop's time."""
        now = self.now()
        for station in self.stations:
            station.advance(now)

    def now(self) -> float:
        """The loop's time. Only where a loop runs."""
        loop = asyncio.get_running_loop()
        if loop is not self._loop:
            self._switch_loop(loop)
        return loop.time()

    def add(self, station: Station) -> None:
        """One more drive; at an address that is taken, a duplicate."""
        self.stations.append(station)
        self._group_stations()

    @property
    def line_quality(self) -> LineQuality:
        return self.wire.line_quality

    @line_quality.setter
    def line_quality(self, weather: LineQuality | str) -> None:
        self.wire.line_quality = parse_line_quality(weather) if isinstance(weather, str) else weather

    def unplug(self) -> None:
        """Pull the adapter: every host loses its port, what is on its way is lost, the drives go on."""
        self.wire.plugged = False
        self.wire.discard_pending()
        hosts, self.masters = self.masters, []
        for host in hosts:
            host.on_unplugged()

    def replug(self) -> None:
        """Put it back."""
        self.wire.plugged = True
        for put_back in self.on_replug:
            put_back()

    # What hosts do.

    def attach(self, master: BusMaster) -> None:
        """From now on ``host`` hears the wire and may ``say``."""
        self.now()
        if self._timer is None:
            assert self._loop is not None
            self._timer = LoopTimer(self._loop, self._deliver_due)
        self.masters.append(master)

    def detach(self, master: BusMaster) -> None:
        """``host`` hears no more. What it said still reaches the drives."""
        if master in self.masters:
            self.masters.remove(master)
        self._release_timer()

    def transmit(self, master: BusMaster, data: bytes) -> None:
        """``host`` puts bytes on the wire, one after another from now on."""
        sides: tuple[Side, ...] = (Side.STATIONS,)
        if self.line_quality.echo or len(self.masters) > 1:
            sides += (Side.MASTERS,)
        self.wire.transmit(master, data, self.now(), sides, master.settings)
        self._arm_timer()

    # How the wire gets round.

    def _group_stations(self) -> None:
        """One ear for all stations that hear alike."""
        groups: dict[Any, tuple[FrameReceiver, list[Station]]] = {}
        for station in self.stations:
            key = (station.rule, tuple((codec.family, codec.encoding) for codec in station.codecs))
            if key not in groups:
                groups[key] = (FrameReceiver(station.codecs, station.rule, self.settings, self.jitter_tolerance_s), [])
            groups[key][1].append(station)
        self._groups = list(groups.values())
        self.wire.station_delays = tuple(sorted({ear.decision_delay_s for ear, _ in self._groups}))

    def set_jitter_tolerance(self, seconds: float) -> None:
        """Measured silences may be short by so much: real ports are delayed by the operating system."""
        self.jitter_tolerance_s = seconds
        for ear, _ in self._groups:
            ear.tolerance_s = seconds

    def _switch_loop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Another loop, another time: what was on the wire is gone, the drives are as they were."""
        self.wire = Wire(self.settings, self.wire.line_quality, self.rng)
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

    def _release_timer(self) -> None:
        """Without hosts and with a quiet wire the alarm is given back."""
        if not self.masters and self.wire.next_event_at() is None and self._timer is not None:
            self._timer.close()
            self._timer = None

    def _arm_timer(self) -> None:
        if self._timer is not None:
            self._timer.set(self.wire.next_event_at())

    def _deliver_due(self) -> None:
        assert self._loop is not None
        now = self._loop.time()
        while (event := self.wire.pop_event(now)) is not None:
            side, said, first, last = event
            if side is Side.MASTERS:
                self._deliver_to_masters(said, first, last)
            else:
                self._deliver_to_stations(said, self.wire.station_delays[last], now)
        self._arm_timer()
        self._release_timer()

    def _deliver_to_masters(self, said: Transmission, first: int, last: int) -> None:
        data, marks = said.received(first, last)
        for host in list(self.masters):
            if not data or (host is said.talker and not self.line_quality.echo):
                continue
            if host.settings is not None and host.settings != self.settings:
                host.receive(self.rng.randbytes(len(data)), len(data))
            else:
                host.receive(data, marks)

    def _deliver_to_stations(self, said: Transmission, wait: float, now: float) -> None:
        data, marks = said.received()
        over = self.wire.silent_since(now) <= said.end + 1e-9
        for ear, stations in self._groups:
            if ear.decision_delay_s != wait:
                continue
            heard = ear.feed(data, marks, said.quiet_s)
            if ear.rule.ends_by_silence and over:
                heard = ear.on_silence()
            for frame in heard:
                self._dispatch(frame, stations, said, now)

    def _dispatch(self, frame: ReceivedFrame, stations: list[Station], said: Transmission, now: float) -> None:
        if frame.address is None:
            return
        for station in stations:
            everybody = frame.address == station.broadcast
            if frame.address != station.address and not everybody:
                station.on_foreign_frame(now)
                continue
            station.record_gap(frame.silence_s, frame.short_gap)
            reply = station.handle_frame(
                frame.message, frame.codec, self.settings, now, error=frame.error, is_broadcast=everybody
            )
            if reply is not None:
                self.wire.transmit_reply(station, reply.data, now, max(now, said.end + reply.delay_s))


def open_port(link: Any) -> Any:
    """Entry point of ``sim://``: see ``drivebus.simulator.port.open_port``."""
    from drivebus.simulator.port import open_port as opened

    return opened(link)
