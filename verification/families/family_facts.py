"""Facts of one protocol family, read a second time from its documents."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from verification.drive_variants import DriveVariant
from verification.reference.effects import ReferenceWrite, RequestEffect


class FamilyFacts(ABC):
    """Variants of one family and the meaning of its frames. Methods on requests raise ValueError for what no document
    defines."""

    variants: tuple[DriveVariant, ...]

    @abstractmethod
    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        """Return a request's address and effect."""

    @abstractmethod
    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        """Return the worst effect of a request, in the variant that the model check uses."""

    @abstractmethod
    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        """Return what a request that is no read writes."""

    @abstractmethod
    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request is a sync probe."""

    @abstractmethod
    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        """Return the key of a status read, equal for equal reads; None for other requests."""

    @abstractmethod
    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        """Return whether a reply shows that the output is off; None where it shows neither."""


def models_of(facts: FamilyFacts) -> Mapping[str, FamilyFacts]:
    """Return each model of the family with its facts."""
    return {variant.model: facts for variant in facts.variants}
