"""Effect and content of any family's request, by its drive variant.

``classify_request`` and ``decode_write`` take requests that the manuals define and raise for others; ``worst_effect``
takes any bytes and assumes motion wherever no manual names what they do.
"""

from __future__ import annotations

from verification.drive_variants import DriveVariant
from verification.families.registry import facts_by_model
from verification.reference.effects import ReferenceWrite, RequestEffect


def classify_request(model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
    """Return a request's address and effect. Raises ValueError for what the manual does not define."""
    return facts_by_model()[model].classify(model, encoding, frame)


def worst_effect(model: str, frame: bytes, command_word: int = 0) -> RequestEffect:
    """Return the worst effect of any bytes (C320 in ASCII, Modbus in RTU).

    ``command_word``: the word that a VC660 was sent before; a changed direction turns a running motor round.
    """
    try:
        return facts_by_model()[model].worst_effect(model, frame, command_word)
    except ValueError:
        return RequestEffect.MOTION


def decode_write(variant: DriveVariant, frame: bytes) -> ReferenceWrite:
    """Return what a request that is no read writes. Raises ValueError for an address or word that no manual lists."""
    return facts_by_model()[variant.model].decode_write(variant, frame)


def is_sync_probe(variant: DriveVariant, frame: bytes) -> bool:
    """Return whether a request is a sync probe."""
    return facts_by_model()[variant.model].is_sync_probe(variant, frame)


def status_read_key(variant: DriveVariant, request: bytes) -> bytes | None:
    """Return the key of a status read, equal for equal reads; None for other requests."""
    return facts_by_model()[variant.model].status_read_key(variant, request)


def shows_standstill(variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
    """Return whether a reply shows that the output is off; None where it shows neither."""
    return facts_by_model()[variant.model].shows_standstill(variant, request, reply)
