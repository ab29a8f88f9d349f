"""What a scan will ask, in which order and how long that takes if nobody answers. Pure; opens nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings

FIXED_SETTINGS_SCHEMES = frozenset({"tcp", "memory", "replay"})
"""Schemes whose line settings are not ours to change: one pass with what they have."""


@dataclass(frozen=True, slots=True)
class ScanCandidate:
    """A model in one encoding: what may be there."""

    profile: DriveProfile
    encoding: str

    @property
    def kind(self) -> tuple[str, str]:
        """Candidates of one kind speak the same frames and are asked together."""
        return self.profile.family, self.encoding


@dataclass(frozen=True, slots=True)
class ScanPass:
    """One opening of the port: these candidates at these addresses under one line setting."""

    settings: SerialSettings
    candidates: tuple[ScanCandidate, ...]
    addresses: tuple[int, ...]
    has_factory_settings: bool
    """Some candidate leaves the factory with these settings."""
    duration_s: float
    """If nobody answers."""

    @property
    def probe_count(self) -> int:
        return len(self.addresses)


def plan_scan(
    profiles: Sequence[DriveProfile],
    *,
    addresses: Sequence[int] | None = None,
    bauds: Sequence[int] | None = None,
    formats: Sequence[str] | None = None,
    encodings: Sequence[str] | None = None,
    fixed: SerialSettings | None = None,
) -> list[ScanPass]:
    """What will be asked, factory settings first. ``fixed``: the port has its own settings and no choice."""
    kinds: dict[tuple[str, str], list[ScanCandidate]] = {}
    for profile in profiles:
        for encoding in profile.encodings:
            if encodings is None or encoding in encodings:
                kinds.setdefault((profile.family, encoding), []).append(ScanCandidate(profile, encoding))
    passes: list[ScanPass] = []
    for candidates in kinds.values():
        for settings in _serial_settings(candidates, bauds, formats, fixed):
            passes.append(_build_pass(candidates, settings, addresses))
    return sorted(passes, key=lambda one: not one.has_factory_settings)


def _serial_settings(
    candidates: Sequence[ScanCandidate],
    bauds: Sequence[int] | None,
    formats: Sequence[str] | None,
    fixed: SerialSettings | None,
) -> list[SerialSettings]:
    """Line settings that some of these candidates can have, each once."""
    if fixed is not None:
        return [fixed]
    found: dict[SerialSettings, None] = {}
    for candidate in candidates:
        line = candidate.profile.serial
        for baud in bauds or (line.baud, *line.bauds):
            for format in formats or (line.format, *line.formats):
                found[SerialSettings.parse(baud, format)] = None
    return list(found)


def _build_pass(
    candidates: Sequence[ScanCandidate], settings: SerialSettings, addresses: Sequence[int] | None
) -> ScanPass:
    low = min(candidate.profile.addresses[0] for candidate in candidates)
    high = max(candidate.profile.addresses[1] for candidate in candidates)
    broadcasts = {candidate.profile.broadcast for candidate in candidates}
    wanted = [a for a in (addresses or range(low, high + 1)) if low <= a <= high and a not in broadcasts]
    factory = any(str(settings) == f"{c.profile.serial.baud} {c.profile.serial.format}" for c in candidates)
    return ScanPass(
        settings, tuple(candidates), tuple(wanted), factory, len(wanted) * probe_duration_s(candidates[0], settings)
    )


def probe_duration_s(candidate: ScanCandidate, settings: SerialSettings) -> float:
    """Seconds that a question to nobody takes: gap, frame, reply timeout."""
    dialect = create_dialect(candidate.profile, max(1, candidate.profile.addresses[0]), encoding=candidate.encoding)
    request = probe_request(dialect)
    codec, timing = dialect.station_config.codec, dialect.station_config.timing
    sent = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + sent + timing.timeout_s(settings, codec.largest_reply(request))


def probe_request(dialect: Dialect) -> Any:
    """The question "is somebody there": the read that shows the state, else the family's fence (a harmless read).

    Raises ValueError if its bytes could do anything else.
    """
    reads = dialect.state_reads()
    request = reads[0] if reads else dialect.station_config.sync_request(0)
    if dialect.station_config.effect_of(dialect.station_config.codec.encode_request(request)) is not Effect.NONE:
        raise ValueError(f"{request} is no pure read")
    return request
