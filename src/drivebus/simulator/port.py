"""``sim://``: a port whose far end is a simulated bus in the same process.

Buses with a ``name=`` are shared: opening the same name again joins the same wire, as a second master or after a
restart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.errors import PortLost, PortUnavailable, PortUrlError
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.models.catalog import make_stations, simulated_models, station_option_names
from drivebus.types import Capabilities, EchoSetting, Receiver


class SimPort:
    """Port of one master on a simulated bus."""

    capabilities = Capabilities(has_line_timing=True, parity=True)

    def __init__(self, bus: SimulatedBus, settings: SerialSettings, url: str, echo: EchoSetting) -> None:
        self.simulated_bus = bus
        self.settings: SerialSettings | None = settings
        self.url = url
        self.echo = echo
        self._receiver: Receiver | None = None

    @property
    def identity(self) -> str:
        return f"sim:{self.simulated_bus.name or self.url}"

    @property
    def drive_options(self) -> dict[int, dict[str, str]]:
        """Profile options that the simulated drives state of themselves, by address."""
        return {station.address: station.profile_options for station in self.simulated_bus.stations}

    async def open(self, receiver: Receiver) -> None:
        """Open the port. Raises PortUnavailable while the bus is unplugged or this port is open."""
        if not self.simulated_bus.wire.plugged:
            raise PortUnavailable("sim.unplugged", port=self.url)
        if self._receiver is not None and self in self.simulated_bus.masters:
            raise PortUnavailable("sim.already_open", port=self.url)
        self.simulated_bus.attach(self)
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Transmit bytes. Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("sim.not_open", port=self.url)
        self.simulated_bus.transmit(self, data)

    def read_pending(self) -> None:
        """Deliver what has arrived by now."""
        self.simulated_bus.deliver_pending()

    async def close(self) -> None:
        """Close the port; the drives go on."""
        self._receiver = None
        self.simulated_bus.detach(self)

    def receive(self, data: bytes, line_errors: int) -> None:
        if self._receiver is not None:
            self._receiver.data_received(data, line_errors)

    def on_unplugged(self) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("sim.lost", port=self.url))


_named_buses: dict[str, SimulatedBus] = {}


def simulated_bus_of(port: object) -> SimulatedBus:
    """Return the simulated bus behind an opened ``sim://`` port. Raises TypeError for another kind of port."""
    if not isinstance(port, SimPort):
        raise TypeError(f"{type(port).__name__} is not the port of a simulated bus")
    return port.simulated_bus


def find_simulated_bus(name: str) -> SimulatedBus:
    """Return the simulated bus of ``sim://…?name=``. Raises KeyError."""
    return _named_buses[name]


def clear_simulated_buses() -> None:
    """Remove every named bus: the next ``name=`` creates a new one."""
    _named_buses.clear()


def open_port(url: Any) -> SimPort:  # PortUrl is of a package that the simulator must not import
    """Return the port of a ``sim://MODEL@ADDRESSES`` URL (``drivebus.ports.url.PortUrl``), not yet opened.

    Raises PortUrlError or ConfigurationError. Options: seed, line_quality, name,
    echo, load, ramp (seconds), drives (serial settings of the stations, ``19200-8E1``, where the master's are wrong on
    purpose), and the options of the models (``direction_field``, …).
    """
    if not url.path:
        raise PortUrlError("sim.empty", port=url.text, models=tuple(simulated_models()))
    url.reject_unknown_options(
        "seed", "line_quality", "name", "echo", "load", "ramp", "drives", *station_option_names()
    )
    name = url.options.get("name", "")
    bus = _named_buses.get(name)
    if bus is None:
        bus = _create_bus(url, name)
        if name:
            _named_buses[name] = bus
    settings = _master_settings(url, bus.stations[0].factory_settings)
    if settings == bus.settings:
        settings = bus.settings  # the same object, so that the wire compares no fields for each frame
    echo: Any = url.choice("echo", ("detect", "on", "off"), "detect" if bus.line_quality.echo else "off")
    return SimPort(bus, settings, url.text, echo)


def _create_bus(url: Any, name: str) -> SimulatedBus:
    names = station_option_names()
    options = {key: value for key, value in url.options.items() if key in names}
    stations = make_stations(url.path, options, url.options.get("load", "constant"))
    ramp_s = url.number("ramp", 10.0, 0.1, 3600.0)
    for station in stations if "ramp" in url.options else ():
        station.set_ramps(ramp_s, ramp_s)
    own_settings = _station_settings(url, _master_settings(url, stations[0].factory_settings))
    seed = int(url.number("seed", 1, 0, 2**31))
    return SimulatedBus(
        stations, own_settings, line_quality=url.options.get("line_quality", "clean"), seed=seed, name=name
    )


def _master_settings(url: Any, factory: SerialSettings) -> SerialSettings:
    """Return the master's serial settings: the URL's, and the factory settings for what it omits."""
    settings: SerialSettings = url.settings
    if "baud" not in url.explicit:
        settings = replace(settings, baud=factory.baud)
    if "format" not in url.explicit:
        settings = SerialSettings(settings.baud, factory.data_bits, factory.parity, factory.stop_bits)
    return settings


def _station_settings(url: Any, default: SerialSettings) -> SerialSettings:
    text = url.options.get("drives")
    if text is None:
        return default
    baud, _, format = text.partition("-")
    try:
        return SerialSettings.parse(int(baud), format or default.format)
    except ValueError:
        raise PortUrlError("sim.drives", port=url.text, found=text, expected="19200-8E1") from None
