"""``sim://``: a port whose far end is a bench in the same process. Satisfies the port protocol structurally.

Benches with a ``name=`` are shared: opening the same name again joins the same wire (a second master, a restarted
host).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

from drivebus.errors import LinkError, PortLost, PortUnavailable
from drivebus.line import LineSettings
from drivebus.sim.bench import Bench
from drivebus.sim.models import SETTINGS, make_stations


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What is real about this port: its timing, and the parity marks of bytes that the wire spoiled."""

    paced: bool = True
    parity: bool = True
    direction_control: bool = False


class Receiver(Protocol):
    """Who is told what comes in."""

    def data_received(self, data: bytes, marks: int = 0) -> None: ...
    def port_lost(self, error: PortLost) -> None: ...


class SimPort:
    """One host's plug on a bench; ``bench`` is there for tests and demos."""

    capabilities = Capabilities()

    def __init__(self, bench: Bench, settings: LineSettings, url: str, echo: Literal["detect", "on", "off"]) -> None:
        self.bench = bench
        self.settings: LineSettings | None = settings
        self.url = url
        self.echo = echo
        self._receiver: Receiver | None = None

    @property
    def identity(self) -> str:
        return f"sim:{self.bench.name or self.url}"

    async def open(self, receiver: Receiver) -> None:
        """Raises PortUnavailable while the bench is unplugged or this port is open."""
        if not self.bench.wire.plugged:
            raise PortUnavailable("sim.unplugged", port=self.url)
        if self._receiver is not None and self in self.bench.hosts:
            raise PortUnavailable("sim.already-open", port=self.url)
        self.bench.attach(self)
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("sim.not-open", port=self.url)
        self.bench.say(self, data)

    async def close(self) -> None:
        """The drives go on."""
        self._receiver = None
        self.bench.detach(self)

    def hear(self, data: bytes, marks: int) -> None:
        if self._receiver is not None:
            self._receiver.data_received(data, marks)

    def lost(self) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("sim.lost", port=self.url))


_benches: dict[str, Bench] = {}


def find_bench(name: str) -> Bench:
    """The bench of ``sim://…?name=``. Raises KeyError."""
    return _benches[name]


def forget_benches() -> None:
    """Forget every named bench: the next ``name=`` makes a new one."""
    _benches.clear()


def open_port(link: Any) -> SimPort:
    """The port of a ``sim://MODEL@ADDRESSES`` link, not yet opened. Raises LinkError or ConfigurationError.

    Options: seed, weather, name, echo, load, ramp (seconds), drives (the stations' own line, ``19200-8E1``, where the
    host's is wrong on purpose), and the open settings of the families (``direction_field``, ``setpoint_coding``, …).
    """
    link.only("seed", "weather", "name", "echo", "load", "ramp", "drives", *SETTINGS)
    name = link.options.get("name", "")
    bench = _benches.get(name)
    if bench is None:
        bench = _bench(link, name)
        if name:
            _benches[name] = bench
    settings = _settings(link, bench.stations[0].line)
    echo: Any = link.choice("echo", ("detect", "on", "off"), "detect" if bench.weather.echo else "off")
    return SimPort(bench, settings, link.text, echo)


def _bench(link: Any, name: str) -> Bench:
    settings = {key: value for key, value in link.options.items() if key in SETTINGS}
    stations = make_stations(link.path, settings, link.options.get("load", "constant"))
    ramp_s = link.number("ramp", 10.0, 0.1, 3600.0)
    for station in stations if "ramp" in link.options else ():
        station.set_ramps(ramp_s, ramp_s)
    line = _drives_line(link, _settings(link, stations[0].line))
    seed = int(link.number("seed", 1, 0, 2**31))
    return Bench(stations, line, weather=link.options.get("weather", "clean"), seed=seed, name=name)


def _settings(link: Any, factory: LineSettings) -> LineSettings:
    """The host's line: what the link does not say is as the drives leave the factory."""
    chosen: LineSettings = link.settings
    if "baud" not in link.given:
        chosen = replace(chosen, baud=factory.baud)
    if "format" not in link.given:
        chosen = LineSettings(chosen.baud, factory.data_bits, factory.parity, factory.stop_bits)
    return chosen


def _drives_line(link: Any, default: LineSettings) -> LineSettings:
    text = link.options.get("drives")
    if text is None:
        return default
    baud, _, format = text.partition("-")
    try:
        return LineSettings.parse(int(baud), format or default.format)
    except ValueError:
        raise LinkError("sim.drives", link=link.text, found=text, expected="19200-8E1") from None
