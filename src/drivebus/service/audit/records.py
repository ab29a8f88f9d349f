"""What is recorded, and what of it may never be: secrets, endless texts. No file and no clock lives here.

Lines that show when they were changed: a record with its own hash, a checkpoint with a keyed one. Pure.

A record's line is one JSON object: ``n`` (1, 2, 3, …), what happened, ``prev`` (the hash of the record before) and, as
its last member, ``hash``: SHA-256 of the line without that member. Only ASCII: control characters, terminal escapes
and line ends in names stand as JSON escapes (S13).
A checkpoint's line holds a record's number and hash, and as its last member ``mac``: HMAC-SHA-256 under a key that
whoever can write the trail need not have.
"""

from __future__ import annotations

import hmac
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from hashlib import sha256
from math import isfinite
from typing import Any, Final

from drivebus.service.auth.actor import Actor
from drivebus.service.live.views import Json

SERVICE_ACTOR: Final = "drivebus"
"""Who did it where the service did."""
SECRET_NAMES: Final = re.compile(
    r"password|passwd|passphrase|secret|token|cookie|csrf|credential|authorization|private_?key|^arm$|^code$", re.I
)
"""Names whose values are never written; ``arm`` and ``code`` open a door for ten seconds."""
EMBEDDED_CREDENTIALS: Final = re.compile(r"(?<=://)[^/@\s]*@|\b(?<=Bearer )\S+")
"""A user and password in an address; a token in a header."""
REDACTED: Final = "***"
MAX_TEXT_LENGTH: Final = 2_000
"""Characters; of a longer text (a whole configuration) its length and SHA-256 are kept."""
MAX_CONTAINER_ITEMS: Final = 500
MAX_NESTING_DEPTH: Final = 8


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One thing that somebody did or asked for. ``what`` is an operation, or ``login``, ``refused``, …"""

    what: str
    who: str = SERVICE_ACTOR
    session: str = ""
    address: str = ""
    target: str = ""
    """The drive, group, bus, user or alarm."""
    params: Mapping[str, Any] = field(default_factory=dict)
    frames: Sequence[Any] = ()
    """As ``plant.failure.frame_json`` tells them."""
    outcome: str | None = None
    """``asked`` before the first frame; afterwards the outcome's word, or an error's key."""
    of: int | None = None
    """The number of the record that asked, in the one that tells what came of it."""

    @classmethod
    def by(cls, actor: Actor, what: str, **more: Any) -> AuditEntry:
        """What somebody did."""
        return cls(what, actor.name, actor.session, actor.address, **more)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> AuditEntry:
        """As another process sends it; members that nobody knows are kept among the parameters."""
        own = {name: found[name] for name in cls.__dataclass_fields__ if found.get(name) is not None}
        params = own.pop("params", {})
        more = {name: value for name, value in found.items() if name not in cls.__dataclass_fields__}
        whole = {**(params if isinstance(params, Mapping) else {"params": params}), **more}
        return cls(**{"what": "", **own}, params=whole)


def entry_json(entry: AuditEntry, time_ms: int) -> Json:
    """What is written of it, secrets hidden."""
    who = {"name": entry.who, "session": entry.session, "address": entry.address}
    return {
        "time_ms": time_ms,
        "who": redact(who),
        "what": redact(entry.what),
        "target": redact(entry.target),
        "params": redact(entry.params),
        "frames": redact(entry.frames),
        "outcome": redact(entry.outcome),
        "of": redact(entry.of),
    }


def redact(value: Any, depth: int = 0) -> Any:
    """The value as JSON, without secrets, of bounded length."""
    if isinstance(value, Enum):
        value = value.value
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else str(value)
    if isinstance(value, bytes | bytearray):
        value = bytes(value).hex(" ").upper()
    if depth < MAX_NESTING_DEPTH and isinstance(value, Mapping):
        return {
            _redact_text(str(name))[:100]: _redact_member(str(name), one, depth)
            for name, one in [*value.items()][:MAX_CONTAINER_ITEMS]
        }
    if depth < MAX_NESTING_DEPTH and isinstance(value, list | tuple | set | frozenset):
        return [redact(one, depth + 1) for one in list(value)[:MAX_CONTAINER_ITEMS]]
    return _limit_length(_redact_text(str(value)))


def _redact_member(name: str, value: Any, depth: int) -> Any:
    return REDACTED if SECRET_NAMES.search(name) and value is not None else redact(value, depth + 1)


def _redact_text(text: str) -> str:
    """No password of an address, no half of a character."""
    return (
        EMBEDDED_CREDENTIALS.sub(lambda found: REDACTED + "@" if found[0].endswith("@") else REDACTED, text)
        .encode("utf-8", "backslashreplace")
        .decode()
    )


def _limit_length(text: str) -> Any:
    if len(text) <= MAX_TEXT_LENGTH:
        return text
    return {"characters": len(text), "sha256": sha256(text.encode()).hexdigest()}


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
