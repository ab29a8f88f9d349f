"""Catalogue of the simulated drives, and the texts that select them: ``c320@0-3,7+vc660@8``.

Each protocol family names its simulated models (``ProtocolFamily.simulated_models``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from drivebus.errors import ConfigurationError
from drivebus.protocols.family import protocol_families, resolve
from drivebus.simulator.motor import Motor, MotorLoad
from drivebus.simulator.station import SimulatedModel, SimulatedStation
from drivebus.user_input import parse_addresses

LOADS: Mapping[str, Callable[[], MotorLoad]] = {"constant": MotorLoad, "fan": MotorLoad.fan, "hoist": MotorLoad.hoist}


def simulated_models() -> dict[str, SimulatedModel]:
    """Return every simulated drive that was written from its manual, by name of its model."""
    by_name: dict[str, SimulatedModel] = {}
    for family in protocol_families():
        for models in family.simulated_models:
            by_name |= resolve(models)
    return by_name


def station_option_names() -> frozenset[str]:
    """Return the option names of all simulated models."""
    return frozenset(name for model in simulated_models().values() for name in model.options)


def simulated_model(name: str) -> SimulatedModel:
    """Return a simulated drive by the name of its model, in any case. Raises ConfigurationError."""
    models = simulated_models()
    model = models.get(name.lower()) or _simulated_from_profile(name)
    if model is None:
        raise ConfigurationError("sim.model", found=name, near=tuple(_similar_models(name) or list(models)[:4]))
    return model


def make_station(
    model: str, address: int, options: Mapping[str, str] | None = None, load: str = "constant"
) -> SimulatedStation:
    """Return one simulated drive; ``options`` of other models are ignored. Raises ConfigurationError."""
    simulated = simulated_model(model)
    addresses = simulated.addresses
    if address not in addresses:
        expected = f"{addresses.start} … {addresses.stop - 1}"
        raise ConfigurationError("sim.address", model=model, found=address, expected=expected)
    if load not in LOADS:
        raise ConfigurationError("sim.setting", name="load", found=load, expected=tuple(LOADS))
    arguments = dict(simulated.fixed)
    for name, value in (options or {}).items():
        if name in simulated.options:
            if value not in simulated.options[name]:
                raise ConfigurationError("sim.setting", name=name, found=value, expected=tuple(simulated.options[name]))
            arguments[name] = value
    return simulated.station(address, motor=Motor(load=LOADS[load]()), **arguments)


def _simulated_from_profile(model: str) -> SimulatedModel | None:
    """Return a drive that does what its profile says: no evidence that the profile is right."""
    for family in protocol_families():
        simulated: SimulatedModel | None = (
            resolve(family.profile_simulator)(model) if family.profile_simulator else None
        )
        if simulated is not None:
            return simulated
    return None


def _similar_models(model: str) -> list[str]:
    """Return the simulated drives whose names are nearest to a name."""
    own = simulated_models()
    similar = [
        name
        for family in protocol_families()
        if family.similar_models
        for name in resolve(family.similar_models)(model)
    ]
    return [name for name in dict.fromkeys(similar) if name in own or _simulated_from_profile(name) is not None]


def make_stations(
    text: str, options: Mapping[str, str] | None = None, load: str = "constant"
) -> list[SimulatedStation]:
    """Return every drive of a text such as ``c320@0-3,7+vc660@8``. Raises ConfigurationError."""
    stations: list[SimulatedStation] = []
    for part in text.split("+"):
        model, separator, addresses = part.partition("@")
        if not separator:
            raise ConfigurationError("sim.target", found=part, expected=("MODEL@ADDRESSES", "c320@0-3,7"))
        try:
            numbers = parse_addresses(addresses)
        except ValueError:
            raise ConfigurationError("sim.addresses", found=addresses, expected="0-3,7") from None
        stations += [make_station(model, address, options, load) for address in numbers]
    return stations
