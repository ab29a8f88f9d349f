"""Codecs, frames and stations of one protocol family for the campaigns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from verification.codec_fuzz.fuzzed_codec import FuzzedCodec
from verification.drive_variants import DriveVariant
from verification.fault_matrix.matrix_family import MatrixFamily
from verification.statements.reaction import StationModel


class StrengthCase(NamedTuple):
    """Reply to a read or write, and its request, of which the strength of the check is computed."""

    name: str
    codec: str
    sent: str
    frame: str


class WorkedFrame(NamedTuple):
    """Exchange that a source prints or that was recorded from a drive; ``reply`` may be empty."""

    name: str
    codec: str
    request: str
    reply: str
    source: str


class WrittenParameter(NamedTuple):
    """Parameter that a campaign reads and writes."""

    notation: str
    saved: bool
    memory_key: int
    """Its key in the memory of the simulated and of the fake station."""
    counts_per_unit: int


@dataclass(frozen=True, kw_only=True)
class FamilyCampaign:
    """Codecs, frames and stations of one family for the campaigns."""

    fuzzed_codecs: tuple[FuzzedCodec, ...]
    codecs_of_vectors: Mapping[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)
    """Model and encoding of a file of ``vectors/`` to the codecs that may receive its frames."""
    missing_requests: Mapping[str, str] = field(default_factory=dict)
    """Requests of the replies in ``vectors/`` that name none."""
    worked_frames: tuple[WorkedFrame, ...] = ()
    """Exchanges that are not in ``vectors/``."""
    strength_cases: tuple[StrengthCase, ...]
    similar_reads: Callable[[DriveVariant, int], tuple[Any, ...]]
    """``(variant, address)`` to reads of one value each whose replies have the same form; all values change."""
    late_parameters: Mapping[str, tuple[str, ...]]
    """Model to the parameters that a user reads; none where the model reads none."""
    stations: Mapping[str, Callable[[], StationModel]]
    """Model to its misbehaving station of the campaign ``statements``."""
    statement_options: Mapping[str, Any] = field(default_factory=dict)
    """Options that a person at the drive has determined."""
    written_parameters: Mapping[str, WrittenParameter] = field(default_factory=dict)
    """Model to the parameter that campaigns read and write; none where the model has none."""
    saved_parameters: Mapping[str, str] = field(default_factory=dict)
    """Model to a parameter that can be saved; none where the model has none."""
    matrix: MatrixFamily
    lacks: frozenset[str] = frozenset()
    """Methods of a drive that this family's drives do not have."""
