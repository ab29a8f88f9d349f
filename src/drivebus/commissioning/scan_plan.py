"""What a scan will ask, in which order and how long that takes if nobody answers. Pure; opens nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.drives.dialect import Dialect
from drivebus.drives.make import make_dialect
from drivebus.line import LineSettings
from drivebus.message import Effect
from drivebus.profiles.model import DriveProfile

FIXED_LINE = frozenset({"tcp", "memory", "replay"})
"""Schemes whose line settings are not ours to change: one pass with what they have."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model in one encoding: what may be there."""

    profile: DriveProfile
    encoding: str

    @property
    def kind(self) -> tuple[str, str]:
        """Candidates of one kind speak the same frames and are asked together."""
        return self.profile.family, self.encoding


@dataclass(frozen=True, slots=True)
class Pass:
    """One opening of the port: these candidates at these addresses under one line setting."""

    settings: LineSettings
    candidates: tuple[Candidate, ...]
    addresses: tuple[int, ...]
    factory: bool
    """Some candidate leaves the factory with these settings."""
    seconds: float
    """If nobody answers."""

    @property
    def questions(self) -> int:
        return len(self.addresses)


def plan(
    profiles: Sequence[DriveProfile],
    *,
    addresses: Sequence[int] | None = None,
    bauds: Sequence[int] | None = None,
    formats: Sequence[str] | None = None,
    encodings: Sequence[str] | None = None,
    fixed: LineSettings | None = None,
) -> list[Pass]:
    """What will be asked, factory settings first. ``fixed``: the port has its own settings and no choice."""
    kinds: dict[tuple[str, str], list[Candidate]] = {}
    for profile in profiles:
        for encoding in profile.encodings:
            if encodings is None or encoding in encodings:
                kinds.setdefault((profile.family, encoding), []).append(Candidate(profile, encoding))
    passes: list[Pass] = []
    for candidates in kinds.values():
        for settings in _settings(candidates, bauds, formats, fixed):
            passes.append(_pass(candidates, settings, addresses))
    return sorted(passes, key=lambda one: not one.factory)


def _settings(
    candidates: Sequence[Candidate],
    bauds: Sequence[int] | None,
    formats: Sequence[str] | None,
    fixed: LineSettings | None,
) -> list[LineSettings]:
    """Line settings that some of these candidates can have, each once."""
    if fixed is not None:
        return [fixed]
    found: dict[LineSettings, None] = {}
    for candidate in candidates:
        line = candidate.profile.line
        for baud in bauds or (line.baud, *line.bauds):
            for format in formats or (line.format, *line.formats):
                found[LineSettings.parse(baud, format)] = None
    return list(found)


def _pass(candidates: Sequence[Candidate], settings: LineSettings, addresses: Sequence[int] | None) -> Pass:
    low = min(candidate.profile.addresses[0] for candidate in candidates)
    high = max(candidate.profile.addresses[1] for candidate in candidates)
    broadcasts = {candidate.profile.broadcast for candidate in candidates}
    wanted = [a for a in (addresses or range(low, high + 1)) if low <= a <= high and a not in broadcasts]
    factory = any(str(settings) == f"{c.profile.line.baud} {c.profile.line.format}" for c in candidates)
    return Pass(settings, tuple(candidates), tuple(wanted), factory, len(wanted) * question_s(candidates[0], settings))


def question_s(candidate: Candidate, settings: LineSettings) -> float:
    """Seconds that a question to nobody takes: gap, frame, reply timeout."""
    dialect = make_dialect(candidate.profile, max(1, candidate.profile.addresses[0]), encoding=candidate.encoding)
    request = probe(dialect)
    codec, timing = dialect.link.codec, dialect.link.timing
    sent = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + sent + timing.timeout_s(settings, codec.largest_reply(request))


def probe(dialect: Dialect) -> Any:
    """The question "is somebody there": the read that shows the state, else the family's fence (a harmless read).

    Raises ValueError if its bytes could do anything else.
    """
    reads = dialect.state_reads()
    request = reads[0] if reads else dialect.link.fence(0)
    if dialect.link.effect(dialect.link.codec.encode_request(request)) is not Effect.NONE:
        raise ValueError(f"{request} is no pure read")
    return request
