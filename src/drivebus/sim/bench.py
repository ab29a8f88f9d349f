"""A bench: one wire with its stations, and the hosts that are plugged into it. The only clock is the event loop's.

In a virtual loop every duration is exact. Hosts are ``SimPort`` (sim://), ptys and TCP connections; two of them on one
bench are two masters.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from drivebus.line import LineSettings
from drivebus.sim.alarm import Alarm
from drivebus.sim.ear import Ear, Heard
from drivebus.sim.station import Station
from drivebus.sim.weather import Weather, parse_weather
from drivebus.sim.wire import Side, Transmission, Wire


class Host(Protocol):
    """Somebody plugged into the wire."""

    settings: LineSettings | None
    """The host's own line settings; None where it has none that could be wrong."""

    def hear(self, data: bytes, marks: int) -> None: ...
    def lost(self) -> None:
        """The bench was unplugged: this host is no longer attached."""
        ...


class Bench:
    """Stations on one wire. ``line`` is theirs; ``seed`` makes noise repeatable: same seed, same bytes."""

    def __init__(
        self,
        stations: Iterable[Station],
        line: LineSettings | None = None,
        *,
        weather: Weather | str = "clean",
        seed: int = 1,
        name: str = "",
    ) -> None:
        self.stations = list(stations)
        self.line = line or (self.stations[0].line if self.stations else LineSettings())
        self.name = name
        self.rng = random.Random(seed)
        chosen = parse_weather(weather) if isinstance(weather, str) else weather
        self.wire = Wire(self.line, chosen, self.rng)
        self.hosts: list[Host] = []
        self.when_replugged: list[Callable[[], None]] = []
        """Called by ``replug``: servers put their ports back."""
        self.tolerance_s = 1e-6
        """By how much a silence may measure short: more on ports that the operating system delays."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._alarm: Alarm | None = None
        self._groups: list[tuple[Ear, list[Station]]] = []
        self._group()

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
            self._move(loop)
        return loop.time()

    def add(self, station: Station) -> None:
        """One more drive; at an address that is taken, a duplicate."""
        self.stations.append(station)
        self._group()

    @property
    def weather(self) -> Weather:
        return self.wire.weather

    @weather.setter
    def weather(self, weather: Weather | str) -> None:
        self.wire.weather = parse_weather(weather) if isinstance(weather, str) else weather

    def unplug(self) -> None:
        """Pull the adapter: every host loses its port, what is on its way is lost, the drives go on."""
        self.wire.plugged = False
        self.wire.cut()
        hosts, self.hosts = self.hosts, []
        for host in hosts:
            host.lost()

    def replug(self) -> None:
        """Put it back."""
        self.wire.plugged = True
        for put_back in self.when_replugged:
            put_back()

    # What hosts do.

    def attach(self, host: Host) -> None:
        """From now on ``host`` hears the wire and may ``say``."""
        self.now()
        if self._alarm is None:
            assert self._loop is not None
            self._alarm = Alarm(self._loop, self._pump)
        self.hosts.append(host)

    def detach(self, host: Host) -> None:
        """``host`` hears no more. What it said still reaches the drives."""
        if host in self.hosts:
            self.hosts.remove(host)
        self._rest()

    def say(self, host: Host, data: bytes) -> None:
        """``host`` puts bytes on the wire, one after another from now on."""
        sides: tuple[Side, ...] = (Side.STATIONS,)
        if self.weather.echo or len(self.hosts) > 1:
            sides += (Side.HOSTS,)
        self.wire.say(host, data, self.now(), sides, host.settings)
        self._set()

    # How the wire gets round.

    def _group(self) -> None:
        """One ear for all stations that hear alike."""
        groups: dict[Any, tuple[Ear, list[Station]]] = {}
        for station in self.stations:
            key = (station.rule, tuple((codec.family, codec.encoding) for codec in station.codecs))
            if key not in groups:
                groups[key] = (Ear(station.codecs, station.rule, self.line, self.tolerance_s), [])
            groups[key][1].append(station)
        self._groups = list(groups.values())
        self.wire.waits = tuple(sorted({ear.wait_s for ear, _ in self._groups}))

    def tolerate(self, seconds: float) -> None:
        """Measured silences may be short by so much: real ports are delayed by the operating system."""
        self.tolerance_s = seconds
        for ear, _ in self._groups:
            ear.tolerance_s = seconds

    def _move(self, loop: asyncio.AbstractEventLoop) -> None:
        """Another loop, another time: what was on the wire is gone, the drives are as they were."""
        self.wire = Wire(self.line, self.wire.weather, self.rng)
        self._group()
        self.hosts.clear()
        if self._alarm is not None:
            self._alarm.close()
            self._alarm = None
        for station in self.stations:
            station.now = None
        self._loop = loop
        for station in self.stations:
            station.advance(loop.time())

    def _rest(self) -> None:
        """Without hosts and with a quiet wire the alarm is given back."""
        if not self.hosts and self.wire.next_at() is None and self._alarm is not None:
            self._alarm.close()
            self._alarm = None

    def _set(self) -> None:
        if self._alarm is not None:
            self._alarm.set(self.wire.next_at())

    def _pump(self) -> None:
        assert self._loop is not None
        now = self._loop.time()
        while (event := self.wire.pop(now)) is not None:
            side, said, first, last = event
            if side is Side.HOSTS:
                self._to_hosts(said, first, last)
            else:
                self._to_stations(said, self.wire.waits[last], now)
        self._set()
        self._rest()

    def _to_hosts(self, said: Transmission, first: int, last: int) -> None:
        data, marks = said.heard(first, last)
        for host in list(self.hosts):
            if not data or (host is said.talker and not self.weather.echo):
                continue
            if host.settings is not None and host.settings != self.line:
                host.hear(self.rng.randbytes(len(data)), len(data))
            else:
                host.hear(data, marks)

    def _to_stations(self, said: Transmission, wait: float, now: float) -> None:
        data, marks = said.heard()
        over = self.wire.quiet_since(now) <= said.end + 1e-9
        for ear, stations in self._groups:
            if ear.wait_s != wait:
                continue
            heard = ear.hear(data, marks, said.quiet_s)
            if ear.rule.ends_by_silence and over:
                heard = ear.silence()
            for frame in heard:
                self._dispatch(frame, stations, said, now)

    def _dispatch(self, frame: Heard, stations: list[Station], said: Transmission, now: float) -> None:
        if frame.address is None:
            return
        for station in stations:
            everybody = frame.address == station.broadcast
            if frame.address != station.address and not everybody:
                station.overheard(now)
                continue
            station.note_gap(frame.quiet_s, frame.short_gap)
            reply = station.heard(frame.message, frame.codec, self.line, now, error=frame.error, everybody=everybody)
            if reply is not None:
                self.wire.reply(station, reply.data, now, max(now, said.end + reply.delay_s))


def open_port(link: Any) -> Any:
    """Entry point of ``sim://``: see ``drivebus.sim.port.open_port``."""
    from drivebus.sim.port import open_port as opened

    return opened(link)
