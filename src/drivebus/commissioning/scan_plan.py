"""Plan of a scan: what to probe, in which order, and how long it takes if no drive answers. Opens no port."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drivebus import profiles
from drivebus.bus.messages import StationConfig
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.profiles.load import included_models
from drivebus.profiles.model import SETPOINT_STEP, DriveProfile
from drivebus.protocols.codec import Effect
from drivebus.protocols.family import common_scan_models, protocol_family
from drivebus.serial_settings import SerialSettings, StationTiming

FIXED_SETTINGS_SCHEMES = frozenset({"tcp", "memory", "replay"})
"""Port schemes whose serial settings can't be changed: they get one pass."""
LIKELY_BAUDS = (9600, 19200, 4800, 38400)
LIKELY_ADDRESSES = range(9)
"""Searched first: nearly every drive is found there, long before the rest."""


@dataclass(frozen=True, slots=True)
class ScanCandidate:
    """Model in one encoding that may be on the bus."""

    profile: DriveProfile
    encoding: str

    @property
    def kind(self) -> tuple[str, str]:
        """Family and encoding: candidates with the same frames are probed together."""
        return self.profile.family, self.encoding


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPass:
    """Scan with a single serial setting: candidates and addresses."""

    settings: SerialSettings
    candidates: tuple[ScanCandidate, ...]
    addresses: tuple[int, ...]
    has_factory_settings: bool
    """The setting is the factory setting of a candidate."""
    is_documented: bool
    """The manual of a candidate has the setting, or the user named it."""
    is_likely: bool
    """Part of the first search, of ``LIKELY_BAUDS`` and ``LIKELY_ADDRESSES``."""
    duration_s: float
    """Duration in seconds if no drive answers."""

    @property
    def probe_count(self) -> int:
        return len(self.addresses)

    @property
    def probe_s(self) -> float:
        """Duration of the probe of one address in seconds if no drive answers."""
        return self.duration_s / self.probe_count

    def station_config(self, dialect: Dialect) -> StationConfig:
        """Return the configuration of a probed station, which waits for the slowest of the candidates."""
        return replace(dialect.station_config, timing=_slowest(dialect.station_config.timing, self.candidates))


def default_models() -> tuple[list[DriveProfile], list[DriveProfile]]:
    """Return the common models of each family, and all others that are included.

    Raises ProfileError for a faulty profile of an installed family.
    """
    common = common_scan_models()
    return [*map(profiles.load, common)], [profiles.load(name) for name in included_models() if name not in common]


def with_look_alikes(wanted: Sequence[DriveProfile]) -> list[DriveProfile]:
    """Add the models of a family that a scan can't tell from a wanted one and that count in another step."""
    families = {profile.family for profile in wanted if SETPOINT_STEP in profile.options}
    known = {profile.model for profile in wanted}
    names = [name for family in sorted(families) for name in protocol_family(family).scan_models if name not in known]
    return [*wanted, *(profile for profile in map(profiles.load, names) if SETPOINT_STEP in profile.options)]


def plan_scan(
    models: Sequence[DriveProfile],
    *,
    others: Sequence[DriveProfile] = (),
    addresses: Sequence[int] | None = None,
    bauds: Sequence[int] | None = None,
    formats: Sequence[str] | None = None,
    encodings: Sequence[str] | None = None,
    fixed: SerialSettings | None = None,
) -> list[ScanPass]:
    """Return the passes: likely ones first, factory settings first among them.

    ``models`` are searched at every setting that one of them can have, and at the likely addresses at ``LIKELY_BAUDS``
    whatever their manual has; ``others`` at these too, and at their factory settings. ``fixed`` is the only setting of
    a port that has no choice.
    """
    kinds: dict[tuple[str, str], list[ScanCandidate]] = {}
    for profile in (*models, *others):
        for encoding in profile.encodings:
            if encodings is None or encoding in encodings:
                kinds.setdefault((profile.family, encoding), []).append(ScanCandidate(profile, encoding))
    rare = {profile.model for profile in others}
    passes: list[ScanPass] = []
    for (family, encoding), candidates in kinds.items():
        needs_8_bits = encoding in protocol_family(family).binary_encodings
        settings_rarity = {fixed: True} if fixed else _serial_settings(candidates, rare, bauds, formats)
        for settings, is_documented in settings_rarity.items():
            if fixed or settings.data_bits == 8 or not needs_8_bits:
                passes += _build_passes(candidates, settings, addresses, is_documented=is_documented)
    return sorted(passes, key=_search_order)


def _search_order(scan_pass: ScanPass) -> tuple[bool, bool, bool, int, int]:
    baud = scan_pass.settings.baud
    rank = LIKELY_BAUDS.index(baud) if baud in LIKELY_BAUDS else len(LIKELY_BAUDS)
    return (
        not scan_pass.is_likely,
        not scan_pass.is_documented,
        not scan_pass.has_factory_settings,
        rank,
        -baud,
    )


def _serial_settings(
    candidates: Sequence[ScanCandidate],
    rare: Collection[str],
    bauds: Sequence[int] | None,
    formats: Sequence[str] | None,
) -> dict[SerialSettings, bool]:
    """Return the settings to search, and whether a manual or the user has them.

    Of a rare model these are its factory setting, in its factory encoding, only.
    """
    settings_rarity: dict[SerialSettings, bool] = {}
    for candidate in candidates:
        serial = candidate.profile.serial
        own_bauds, own_formats = (serial.baud, *serial.bauds), (serial.format, *serial.formats)
        if candidate.profile.model in rare:
            if candidate.encoding != candidate.profile.encodings[0]:
                continue
            own_bauds, own_formats = (serial.baud,), (serial.format,)
        likely = () if bauds or candidate.profile.model in rare else LIKELY_BAUDS
        for baud in (*(bauds or own_bauds), *likely):
            is_documented = baud in (bauds or own_bauds)
            for format in formats or own_formats:
                settings = SerialSettings.parse(baud, format)
                settings_rarity[settings] = settings_rarity.get(settings, False) or is_documented
    return settings_rarity


def _build_passes(
    candidates: Sequence[ScanCandidate],
    settings: SerialSettings,
    addresses: Sequence[int] | None,
    *,
    is_documented: bool,
) -> list[ScanPass]:
    """Return one pass over the likely addresses, and one over the others of a documented setting, if there are any."""
    low = min(candidate.profile.addresses[0] for candidate in candidates)
    high = max(candidate.profile.addresses[1] for candidate in candidates)
    broadcasts = {candidate.profile.broadcast for candidate in candidates}
    searched = [a for a in (addresses or range(low, high + 1)) if low <= a <= high and a not in broadcasts]
    factory_settings = {f"{c.profile.serial.baud} {c.profile.serial.format}" for c in candidates}
    is_likely_baud = settings.baud in LIKELY_BAUDS
    likely = tuple(address for address in searched if is_likely_baud and address in LIKELY_ADDRESSES)
    others = tuple(address for address in searched if is_documented and address not in likely)
    probe_s = probe_duration_s(candidates, settings)
    return [
        ScanPass(
            settings=settings,
            candidates=tuple(candidates),
            addresses=part,
            has_factory_settings=str(settings) in factory_settings,
            is_documented=is_documented,
            is_likely=part is likely,
            duration_s=len(part) * probe_s,
        )
        for part in (likely, others)
        if part
    ]


def durations_s(passes: Sequence[ScanPass]) -> tuple[float, float]:
    """Return the seconds of the likely passes and of all passes if no drive answers."""
    return sum(each.duration_s for each in passes if each.is_likely), sum(each.duration_s for each in passes)


def device_duration_s(scan_pass: ScanPass) -> float:
    """Return the most seconds that a device adds that answers one probe: it is asked for every candidate."""
    reads: set[tuple[bytes, int]] = set()
    for candidate in scan_pass.candidates:
        address = max(1, candidate.profile.addresses[0])
        dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
        requests = [probe_request(dialect), *further_reads(dialect), *dialect.identity_reads()]
        reads |= {probe_frame(dialect, request) for request in requests}
    return len(reads) * scan_pass.probe_s


def probe_duration_s(candidates: Sequence[ScanCandidate], settings: SerialSettings) -> float:
    """Return the seconds of a probe without reply: gap, frame of the first candidate, timeout of the slowest."""
    first = candidates[0]
    dialect = create_dialect(first.profile, max(1, first.profile.addresses[0]), encoding=first.encoding)
    request, codec = probe_request(dialect), dialect.codec
    timing = _slowest(dialect.station_config.timing, candidates)
    sent_s = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + sent_s + timing.timeout_s(settings, codec.largest_reply(request))


def _slowest(timing: StationTiming, candidates: Sequence[ScanCandidate]) -> StationTiming:
    """Return a timing with the longest reply delay of the candidates."""
    timings = [timing, *(candidate.profile.timing for candidate in candidates)]
    return replace(
        timing,
        reply_delay_s=max(each.reply_delay_s for each in timings),
        reply_delay_characters=max(each.reply_delay_characters for each in timings),
        max_reply_lateness_s=max(each.max_reply_lateness_s for each in timings),
    )


def probe_request(dialect: Dialect) -> Any:
    """Return the probe of an address: the read of the status alone, or of one signal where the drive reports none.

    Raises ValueError if its bytes could do more than read.
    """
    request = dialect.echo_test_read()
    if dialect.station_config.effect_of(dialect.station_config.codec.encode_request(request)) is not Effect.NONE:
        raise ValueError(f"{request} is not a read")
    return request


def probe_frame(dialect: Dialect, request: Any) -> tuple[bytes, int]:
    """Return the bytes of a read and the size of its reply: two models with the same are asked once."""
    return dialect.codec.encode_request(request), dialect.codec.reply_size(request)


def further_reads(dialect: Dialect) -> list[Any]:
    """Return the reads of state and identity that show whether a station that answered its probe is the model."""
    return [read for read in (*dialect.state_reads()[:1], dialect.model_check()) if read is not None]
