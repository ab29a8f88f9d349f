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

from drivebus.plant.view import Json

FIRST: Final = "0" * 64
"""What stands before the first record."""
LONGEST_LINE: Final = 64 * 1024
"""Octets. Of a longer record the parameters and frames are left out, and their SHA-256 stands there instead."""
_HEX = 64


@dataclass(frozen=True, slots=True)
class Record:
    """A line of the trail whose own hash is right."""

    n: int
    prev: str
    hash: str
    checkpoints: int
    """So many checkpoints had been written before it."""
    body: Json


@dataclass(frozen=True, slots=True)
class Checkpoint:
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


def record_line(n: int, prev: str, checkpoints: int, body: Json) -> tuple[bytes, str]:
    """A record's line with its line end, and its hash."""
    line, hash = _sealed({"n": n, **body, "checkpoints": checkpoints, "prev": prev}, "hash", _sha)
    if len(line) <= LONGEST_LINE:
        return line, hash
    left_out = {"octets": len(line), "sha256": sha256(line).hexdigest()}
    return record_line(n, prev, checkpoints, body | {"params": {"left_out": left_out}, "frames": []})


def record(line: bytes) -> Record | None:
    """The record of a line (without its line end); None where it is none, or was changed."""
    found = _opened(line, "hash", _sha)
    if found is None:
        return None
    body, hash = found
    n, prev, checkpoints = body.pop("n", None), body.pop("prev", None), body.pop("checkpoints", None)
    if not all(type(one) is int for one in (n, checkpoints, body.get("time_ms"))) or not isinstance(prev, str):
        return None
    return Record(n, prev, hash, checkpoints, body)


def checkpoint_line(number: int, last: tuple[int, str], prev: str, time_ms: int, key: bytes) -> tuple[bytes, str]:
    """A checkpoint's line with its line end, and its MAC. ``last``: the last record's number and hash."""
    body = {"checkpoint": number, "n": last[0], "hash": last[1], "time_ms": time_ms, "prev": prev}
    return _sealed(body, "mac", _mac(key))


def checkpoint(line: bytes, key: bytes | None) -> Checkpoint | None:
    """The checkpoint of a line; None where it is none, or not made under ``key``. Without one only its form counts."""
    found = _opened(line, "mac", None if key is None else _mac(key))
    if found is None:
        return None
    body, mac = found
    try:
        made = Checkpoint(body["checkpoint"], body["n"], body["hash"], body["prev"], mac, body["time_ms"])
    except KeyError:
        return None
    numbers, words = (made.number, made.n, made.time_ms), (made.hash, made.prev)
    return made if all(type(one) is int for one in numbers) and all(isinstance(one, str) for one in words) else None


def _sha(data: bytes) -> str:
    return sha256(data).hexdigest()


def _mac(key: bytes) -> Callable[[bytes], str]:
    return lambda data: hmac.new(key, data, sha256).hexdigest()


def _sealed(body: Json, name: str, digest: Callable[[bytes], str]) -> tuple[bytes, str]:
    data = json.dumps(body, separators=(",", ":"), allow_nan=False).encode("ascii")
    found = digest(data)
    return data[:-1] + _seal(name, found) + b"\n", found


def _seal(name: str, digest: str) -> bytes:
    return f',"{name}":"{digest}"}}'.encode("ascii")


def _opened(line: bytes, name: str, digest: Callable[[bytes], str] | None) -> tuple[dict[str, Any], str] | None:
    """What was sealed, where the seal stands at its place and fits every octet before it."""
    size = len(_seal(name, "0" * _HEX))
    data, seal = line[:-size] + b"}", line[-size:]
    try:
        found = seal[-_HEX - 2 : -2].decode("ascii")
        if seal != _seal(name, found) or (digest is not None and not hmac.compare_digest(digest(data), found)):
            return None
        body = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return (body, found) if isinstance(body, dict) else None
