"""Lines that show when they were changed: a record with its own hash, a checkpoint with a keyed one. Pure.

A record's line is one JSON object: ``n`` (1, 2, 3, …), what happened, ``prev`` (the hash of the record before) and, as
its last member, ``hash``: SHA-256 of the line without that member. Only ASCII: control characters, terminal escapes
and line ends in names stand as JSON escapes (S13).
A checkpoint's line holds a record's number and hash, and as its last member ``mac``: HMAC-SHA-256 under a key that
whoever can write the trail need not have.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final

from drivebus.service.live.views import Json

GENESIS_HASH: Final = "0" * 64
"""What stands before the first record."""
MAX_RECORD_LINE_BYTES: Final = 64 * 1024
"""Octets. Of a longer record the parameters and frames are left out, and their SHA-256 stands there instead."""
_DIGEST_HEX_LENGTH = 64


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """A line of the trail whose own hash is right."""

    n: int
    prev: str
    hash: str
    checkpoints: int
    """So many checkpoints had been written before it."""
    body: Json


@dataclass(frozen=True, slots=True)
class AuditCheckpoint:
    """A line of the second file."""

    number: int
    """1, 2, 3, …"""
    n: int
    """The record that was the last one."""
    hash: str
    """That record's."""
    prev: str
    """``mac`` of the checkpoint before."""
    mac: str
    time_ms: int


def encode_record(n: int, prev: str, checkpoints: int, body: Json) -> tuple[bytes, str]:
    """A record's line with its line end, and its hash."""
    line, hash = _append_digest({"n": n, **body, "checkpoints": checkpoints, "prev": prev}, "hash", _sha)
    if len(line) <= MAX_RECORD_LINE_BYTES:
        return line, hash
    left_out = {"octets": len(line), "sha256": sha256(line).hexdigest()}
    return encode_record(n, prev, checkpoints, body | {"params": {"left_out": left_out}, "frames": []})


def decode_record(line: bytes) -> AuditRecord | None:
    """The record of a line (without its line end); None where it is none, or was changed."""
    found = _verify_digest(line, "hash", _sha)
    if found is None:
        return None
    body, hash = found
    n, prev, checkpoints = body.pop("n", None), body.pop("prev", None), body.pop("checkpoints", None)
    if not all(type(one) is int for one in (n, checkpoints, body.get("time_ms"))) or not isinstance(prev, str):
        return None
    return AuditRecord(n, prev, hash, checkpoints, body)


def encode_checkpoint(number: int, last: tuple[int, str], prev: str, time_ms: int, key: bytes) -> tuple[bytes, str]:
    """A checkpoint's line with its line end, and its MAC. ``last``: the last record's number and hash."""
    body = {"checkpoint": number, "n": last[0], "hash": last[1], "time_ms": time_ms, "prev": prev}
    return _append_digest(body, "mac", _mac(key))


def decode_checkpoint(line: bytes, key: bytes | None) -> AuditCheckpoint | None:
    """The checkpoint of a line; None where it is none, or not made under ``key``. Without one only its form counts."""
    found = _verify_digest(line, "mac", None if key is None else _mac(key))
    if found is None:
        return None
    body, mac = found
    try:
        made = AuditCheckpoint(body["checkpoint"], body["n"], body["hash"], body["prev"], mac, body["time_ms"])
    except KeyError:
        return None
    numbers, words = (made.number, made.n, made.time_ms), (made.hash, made.prev)
    return made if all(type(one) is int for one in numbers) and all(isinstance(one, str) for one in words) else None


def _sha(data: bytes) -> str:
    return sha256(data).hexdigest()


def _mac(key: bytes) -> Callable[[bytes], str]:
    return lambda data: hmac.new(key, data, sha256).hexdigest()


def _append_digest(body: Json, name: str, digest: Callable[[bytes], str]) -> tuple[bytes, str]:
    data = json.dumps(body, separators=(",", ":"), allow_nan=False).encode("ascii")
    found = digest(data)
    return data[:-1] + _digest_member(name, found) + b"\n", found


def _digest_member(name: str, digest: str) -> bytes:
    return f',"{name}":"{digest}"}}'.encode("ascii")


def _verify_digest(line: bytes, name: str, digest: Callable[[bytes], str] | None) -> tuple[dict[str, Any], str] | None:
    """What was sealed, where the seal stands at its place and fits every octet before it."""
    size = len(_digest_member(name, "0" * _DIGEST_HEX_LENGTH))
    data, seal = line[:-size] + b"}", line[-size:]
    try:
        found = seal[-_DIGEST_HEX_LENGTH - 2 : -2].decode("ascii")
        if seal != _digest_member(name, found) or (digest is not None and not hmac.compare_digest(digest(data), found)):
            return None
        body = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return (body, found) if isinstance(body, dict) else None
