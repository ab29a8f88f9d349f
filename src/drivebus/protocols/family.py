"""Protocol families: one object per family, and the registry from which the rest of the package takes it.

No table elsewhere is keyed by family names. This module is below ``profiles``, ``drives`` and ``simulator``, and names
objects of those layers by import path (``package.module:attribute``), resolved on first use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final, Literal

from drivebus import i18n
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.protocols.codec import Codec

BUILT_IN: Final = (
    "drivebus.protocols.sunfar.family:FAMILY",
    "drivebus.protocols.dzb100.family:FAMILY",
    "drivebus.protocols.modbus.family:FAMILY",
    "drivebus.families.huanyang:FAMILY",
    "drivebus.families.mitsubishi:FAMILY",
)
ENTRY_POINT_GROUP: Final = "drivebus.families"
"""Entry points by which other packages register a family; each names a ``ProtocolFamily``."""

Locator = tuple[str, int]
"""Address space and index within it; the family defines both."""
JogFrequency = Literal["drive", "command", "either"]
"""Source of the jog frequency. drive: its own setting; command: every jog frame; either: the frame where it has one."""


@dataclass(frozen=True, kw_only=True)
class NotationStyle:
    """The way a manual writes parameter and signal addresses."""

    examples: tuple[str, ...]
    """Addresses that error texts show."""
    parse: Callable[[str, int, Mapping[str, int]], Locator | None]
    """(upper-case text, highest index, group sizes) to locator; None for text of another form.

    Raises ProfileError ``profiles.unplaced`` or ``profiles.beyond_group`` where group sizes decide.
    """
    format: Callable[[Locator, int], str]
    """(locator, highest index) to text."""
    is_raw_address: Callable[[str], bool] = lambda text: False
    """The upper-case text is a bare address: it may be read, but never written without a profile entry."""


@dataclass(frozen=True, kw_only=True)
class ProtocolFamily:
    """All drives that use the same frames. ``Any`` fields hold an object or its import path (see ``resolve``)."""

    name: str
    codecs: Mapping[str, Callable[[], Codec]]
    """Encoding to its codec with default options; the first encoding is the default."""
    first_bytes: Mapping[int, str] = field(default_factory=dict)
    """First byte of a frame to its encoding, where the byte decides it."""
    addresses: tuple[int, int]
    """Lowest and highest station address; the broadcast address is not among them."""
    broadcast: int | None
    gap_characters: float
    """Least silence before a frame, in characters; 0 where the manual gives none."""
    max_error_rate: float = 0.01
    """Share of damaged replies above which no start is permitted."""
    jog_frequency: JogFrequency
    """Where the frequency of a jog comes from."""
    notations: Mapping[str, NotationStyle]
    """Values of ``[notation] style`` that a profile of this family may have."""
    register_based: bool = False
    """Commands and status are bits of registers that each profile describes (``[commands]``, ``[status]``)."""
    describe: Any
    """``(profile, data, encoding, direction, request) -> FrameDescription``; never raises for any bytes."""
    dialect: Any
    """``(profile, address, encoding, options, timing) -> drives.dialects.Dialect``."""
    calibrations: Any = ()
    """Tuple of ``drives.operations.calibration.CalibrationStep``, in the order of their dependencies."""
    scale_option: str | None = None
    """Option of its profiles that determines the scale of the setpoint: its dialect has a cap until then. None: where a
    profile only assumes the scale, it has the option ``setpoint_step``."""
    simulated_models: tuple[Any, ...] = ()
    """Mappings of model name to ``simulator.station.SimulatedModel``."""
    profile_simulator: Any = None
    """``model -> simulator.station.SimulatedModel | None``, for a profile without a simulated drive of its own."""
    similar_models: Any = None
    """``name -> list of similar model names``, for a simulated drive that does not exist."""
    scan_models: tuple[str, ...] = ()
    """Common models: a scan looks for them first, and at every serial setting that they can have."""
    binary_encodings: frozenset[str] = frozenset()
    """Encodings whose bytes need 8 data bits."""
    profiles: Path | None = None
    """Folder of the TOML profiles that come with the family; None: they are with the built-in ones."""
    catalogues: Path | None = None
    """Folder of its texts, ``<name>.<language>.json``; None: they are with the built-in ones."""

    @property
    def encodings(self) -> tuple[str, ...]:
        return tuple(self.codecs)


def protocol_family(name: str) -> ProtocolFamily:
    """Return the family of this name. Raises ConfigurationError where there is none, or where it can't be imported."""
    family = _built_in().get(name) or _registered.get(name)
    if family is not None:
        return family
    for point in _entry_points():
        if point.name == name:
            return _load(point)
    raise ConfigurationError("families.unknown", found=name, expected=tuple(f.name for f in protocol_families()))


def protocol_families() -> tuple[ProtocolFamily, ...]:
    """Return every family: built-in ones first. One that can't be imported is left out."""
    families = _built_in() | _registered
    for point in _entry_points():
        if point.name not in families:
            try:
                families[point.name] = _load(point)
            except ConfigurationError:
                continue
    return tuple(families.values())


def common_scan_models() -> tuple[str, ...]:
    """Return the common models of every family, those that a scan looks for first."""
    return tuple(model for family in protocol_families() for model in family.scan_models)


def register(family: ProtocolFamily) -> None:
    """Add a family without an entry point. Raises ValueError for the name of a built-in family."""
    if family.name in _built_in():
        raise ValueError(f"family {family.name} is built in")
    _add_texts(family)
    _registered[family.name] = family


def resolve(target: Any) -> Any:
    """Return the object of an import path ``package.module:attribute``; any other object as it is."""
    if not isinstance(target, str):
        return target
    module, _, attribute = target.partition(":")
    return getattr(import_module(module), attribute)


def clear_registry() -> None:
    """Remove registered families; entry points are looked up again."""
    _registered.clear()
    _entry_points.cache_clear()


_registered: dict[str, ProtocolFamily] = {}


@cache
def _built_in() -> dict[str, ProtocolFamily]:
    families: list[ProtocolFamily] = [resolve(path) for path in BUILT_IN]
    for family in families:
        _add_texts(family)
    return {family.name: family for family in families}


def _add_texts(family: ProtocolFamily) -> None:
    if family.catalogues is not None:
        i18n.add_folder(family.catalogues)


@cache
def _entry_points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=ENTRY_POINT_GROUP))


def _load(point: EntryPoint) -> ProtocolFamily:
    try:
        family = point.load()
    except Exception as error:
        raise ConfigurationError(
            "families.broken", found=point.name, module=point.value, reason=SystemReason(error)
        ) from error
    if not isinstance(family, ProtocolFamily) or family.name != point.name:
        reason = ConfigurationError("families.no_family", name=point.name)
        raise ConfigurationError("families.broken", found=point.name, module=point.value, reason=reason)
    register(family)
    return family
