"""``simulate``: simulated drives on a pty or a TCP port, for any master."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Choice, CliCommand, Option
from drivebus.cli.connect import reject_unknown_option
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.simulator.bus import SimulatedBus


def _parse_bind(text: str) -> tuple[str, int] | None:
    """Parse ``pty`` (None) or ``tcp://HOST:PORT``. Raises ValueError."""
    if text == "pty":
        return None
    scheme, separator, rest = text.partition("://")
    host, colon, port = rest.rpartition(":")
    if scheme != "tcp" or not separator or not colon or not port.isdecimal() or int(port) > 65535:
        raise ValueError(text)
    return host or "127.0.0.1", int(port)


def _simulate(
    *,
    model: str,
    address: tuple[int, ...],
    bind: tuple[str, int] | None,
    link: str | None,
    baud: int | None,
    format: str | None,
    encoding: str | None,
    seed: int,
    line_quality: str,
    load: str,
    ramp: float,
    option: tuple[tuple[str, str], ...],
) -> ExitCode:
    from drivebus.simulator.models.catalog import simulated_model

    known = simulated_model(model).options
    for name, _ in option:
        reject_unknown_option(model, name, known)
    options = dict(option) | ({"encoding": encoding} if encoding else {})
    bus = make_bus(
        model,
        address,
        baud=baud,
        format=format,
        seed=seed,
        line_quality=line_quality,
        load=load,
        ramp_s=ramp,
        options=options,
    )
    _check_encoding(bus, model, encoding)
    return asyncio.run(_serve(bus, bind, link))


def _check_encoding(bus: SimulatedBus, model: str, encoding: str | None) -> None:
    """Raise ConfigurationError for an encoding in which the simulated drives do not answer."""
    from drivebus.errors import ConfigurationError

    known = tuple(codec.encoding for codec in bus.stations[0].codecs)
    if encoding is not None and encoding not in known:
        raise ConfigurationError("sim.encoding", model=model, found=encoding, expected=known)


def make_bus(
    model: str,
    addresses: tuple[int, ...],
    *,
    baud: int | None,
    format: str | None,
    seed: int,
    line_quality: str,
    load: str,
    ramp_s: float,
    options: dict[str, str],
) -> SimulatedBus:
    """Return a bus of stations; default serial settings: the model's factory settings. Raises ConfigurationError."""
    from drivebus.serial_settings import SerialSettings
    from drivebus.simulator.bus import SimulatedBus
    from drivebus.simulator.models.catalog import make_station

    stations = [make_station(model, address, options, load) for address in addresses]
    for station in stations:
        station.set_ramps(ramp_s, ramp_s)
    factory = stations[0].factory_settings
    settings = SerialSettings.parse(baud or factory.baud, format or factory.format)
    return SimulatedBus(stations, settings, line_quality=line_quality, seed=seed)


async def _serve(bus: SimulatedBus, bind: tuple[str, int] | None, link: str | None) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals

    with shutdown_signals() as shutdown:
        server = await _open(bus, bind, link)
        try:
            output.print_json(
                {"url": server.url, "serial": str(bus.settings), "stations": len(bus.stations)}, stream=True
            )
            output.print_message("simulate.ready", url=server.url, serial=bus.settings, count=len(bus.stations))
            await shutdown.wait()
        finally:
            await server.close()
    return ExitCode.DONE


async def _open(bus: SimulatedBus, bind: tuple[str, int] | None, link: str | None) -> Any:
    """Open a server on a pty or a TCP port. Raises PortUnavailable."""
    from drivebus.errors import ConfigurationError, PortUnavailable, SystemReason

    try:
        if bind is not None:
            from drivebus.simulator.tcp_server import serve_tcp

            return await serve_tcp(bus, *bind)
        from drivebus.simulator.pty_server import serve_pty

        return await serve_pty(bus, link)
    except ImportError as error:
        raise ConfigurationError("simulate.no_pty") from error
    except OSError as error:
        where = link or "pty" if bind is None else f"tcp://{bind[0]}:{bind[1]}"
        raise PortUnavailable("simulate.cannot_listen", where=where, reason=SystemReason(error)) from error


command = CliCommand(
    "simulate",
    callback=_simulate,
    params=[
        options.model_option(),
        Option(
            ["--address"],
            required=True,
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.addresses",
            example="--address 0-3,7",
        ),
        Option(
            ["--bind"],
            default="pty",
            type=options.ParsedType("bind", _parse_bind, "cli.expect.bind"),
            metavar="pty|tcp://HOST:PORT",
            example="--bind tcp://127.0.0.1:4001",
        ),
        Option(["--link"], metavar="PATH", key="help.option.link_path", example="--link /tmp/drives"),
        *options.serial_options("help.option.simulated"),
        options.encoding_option(),
        Option(["--seed"], type=options.SEED, default=1, metavar="N", example="--seed 7"),
        Option(["--line-quality"], default="clean", metavar="SPEC", example="--line-quality loss=0.05,late=0.1:0.4"),
        Option(["--load"], default="constant", type=Choice(["constant", "fan", "hoist"]), example="--load fan"),
        Option(["--ramp"], default=10.0, type=options.NumberType(0.1, 3600.0), metavar="S", example="--ramp 4"),
        options.profile_option("help.option.simulated.option"),
    ],
    examples=(
        "drivebus simulate --model c320 --address 0-3,7 --bind pty --link /tmp/pumps",
        "drivebus simulate --model vc660 --address 1 --bind tcp://127.0.0.1:4001 --json",
        "drivebus simulate --model df800 --address 1-4 --line-quality lossy --seed 7",
    ),
)
