"""Content and encoding of audit records and checkpoints: redaction of secrets, hash chain, keyed checkpoints. Pure.

A record is one line of ASCII JSON: ``n`` (1, 2, 3, …), the entry, ``prev`` (hash of the record before) and, as its last
member, ``hash``: SHA-256 of the line without that member. ASCII, because then control characters, terminal escapes
and line ends in names are JSON escapes and cannot forge a line.
A checkpoint is a line with a record's number and hash and, as its last member, ``mac``: HMAC-SHA-256 under a key that
a program with write access to the trail need not have (RFC 2104). ``docs/explanation/audit.md`` states what they prove.
"""

from __future__ import annotations

import hmac
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from hashlib import sha256
from math import isfinite
from typing import Any, Final

from drivebus.service.auth.actor import SERVICE_NAME, Actor
from drivebus.types import Json

SECRET_NAMES: Final = re.compile(
    r"password|passwd|passphrase|secret|token|cookie|csrf|credential|authorization|private_?key|^arm$|^code$", re.I
)
"""Names of members whose values are never written. ``arm`` and ``code`` are tokens that start a drive or log in."""
EMBEDDED_CREDENTIALS: Final = re.compile(r"(?<=://)[^/@\s]*@|\b(?<=Bearer )\S+")
"""User and password in a URL; token in an Authorization header."""
REDACTED: Final = "***"
SESSION_ENDED: Final = "session.ended"
"""Record of the end of a session or token that had control of drives."""
OTHERS: Final = "*"
"""In place of the targets and errors of requests of several kinds that are counted together."""
MAX_TEXT_LENGTH: Final = 2_000
"""Characters; a longer text (a whole configuration) is replaced by its length and SHA-256."""
MAX_CONTAINER_ITEMS: Final = 500
MAX_NESTING_DEPTH: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEntry:
    """Entry of the audit trail: one action or request. ``what`` is an operation, ``login``, ``refused``, …"""

    what: str
    who: str = SERVICE_NAME
    session: str = ""
    address: str = ""
    target: str = ""
    """The drive, group, bus, user or alarm."""
    params: Mapping[str, Any] = field(default_factory=dict)
    frames: Sequence[Any] = ()
    """Frames in the form of ``service.api.errors.exchange_json``."""
    outcome: str | None = None
    """``requested`` before the first frame; afterwards the outcome's status or an error's key."""
    of: int | None = None
    """Number of the record of the request whose outcome this is."""

    @classmethod
    def by(cls, actor: Actor, what: str, **more: Any) -> AuditEntry:
        """Return the entry of an action of ``actor``."""
        return cls(what=what, who=actor.name, session=actor.session, address=actor.address, **more)

    @classmethod
    def from_json(cls, data: Mapping[str, Any], actor: Actor) -> AuditEntry:
        """Return the entry of ``actor`` that another process sent. Unknown members become parameters."""
        own = {name: data[name] for name in cls.__dataclass_fields__ if data.get(name) is not None}
        params = own.pop("params", {})
        more = {name: value for name, value in data.items() if name not in cls.__dataclass_fields__}
        identity = {"who": actor.name, "session": actor.session, "address": actor.address}
        whole = {**(params if isinstance(params, Mapping) else {"params": params}), **more}
        return cls(**{"what": "", **own, **identity}, params=whole)


def entry_json(entry: AuditEntry, time_ms: int) -> Json:
    """Return the JSON body of a record, with secrets redacted."""
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


def record_octets(entry: AuditEntry) -> int:
    """Return the approximate size of the record of an entry, in octets.

    Only the first frames are encoded, the others have the average size of these: a stop of all drives has thousands.
    """
    sample = entry.frames[:_SAMPLED_FRAMES]
    octets = len(json.dumps(entry_json(replace(entry, frames=sample), 0))) + _CHAIN_OCTETS
    others = min(len(entry.frames), MAX_CONTAINER_ITEMS) - len(sample)
    if others:
        octets += others * len(json.dumps(redact(sample))) // len(sample)
    return min(octets, MAX_RECORD_LINE_BYTES)


def redact(value: Any, depth: int = 0) -> Any:
    """Return ``value`` as JSON of bounded size, with secrets redacted."""
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
            _redact_text(str(name))[:100]: _redact_member(str(name), member, depth)
            for name, member in [*value.items()][:MAX_CONTAINER_ITEMS]
        }
    if depth < MAX_NESTING_DEPTH and isinstance(value, list | tuple | set | frozenset):
        return [redact(item, depth + 1) for item in list(value)[:MAX_CONTAINER_ITEMS]]
    return _limit_length(_redact_text(str(value)))


def _redact_member(name: str, value: Any, depth: int) -> Any:
    return REDACTED if SECRET_NAMES.search(name) and value is not None else redact(value, depth + 1)


def _redact_text(text: str) -> str:
    """Replace credentials in URLs and headers, and escape lone surrogates."""
    return (
        EMBEDDED_CREDENTIALS.sub(lambda found: REDACTED + "@" if found[0].endswith("@") else REDACTED, text)
        .encode("utf-8", "backslashreplace")
        .decode()
    )


def _limit_length(text: str) -> Any:
    if len(text) <= MAX_TEXT_LENGTH:
        return text
    return {"characters": len(text), "sha256": sha256(text.encode()).hexdigest()}


ERROR_TEXT: Final = "error_text"
"""Parameter of a failed command: the sentence of its error by language."""
ERROR_TEXTS: Final = "error_texts"
"""Parameter of a command to several drives: the sentence of the error of each, or the id of a drive that has it too."""
MAX_ERROR_TEXTS = 4
"""Different sentences of one error that a record keeps; it shows one less, as more may have been left out."""
GENESIS_HASH: Final = "0" * 64
"""``prev`` of the first record."""
MAX_RECORD_LINE_BYTES: Final = 64 * 1024
"""A longer record has the SHA-256 of its line in place of its frames and, where it is still too long, parameters."""
_DIGEST_HEX_LENGTH = 64
_SAMPLED_FRAMES = 10
_CHAIN_OCTETS = 200  # number, number of checkpoints and the two hashes of a record


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """Record whose hash matches its line."""

    n: int
    prev: str
    hash: str
    checkpoints: int
    """Number of checkpoints written before it."""
    body: Json


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditCheckpoint:
    """Line of the checkpoint file."""

    number: int
    """1, 2, 3, …"""
    n: int
    """Number of the last record at that time."""
    hash: str
    """Hash of that record."""
    prev: str
    """``mac`` of the previous checkpoint."""
    mac: str
    time_ms: int


def encode_record(n: int, prev: str, checkpoints: int, body: Json) -> tuple[bytes, str]:
    """Return a record's line, with its line end, and its hash. One too long loses its frames, then its parameters."""
    line, hash = _append_digest({"n": n, **body, "checkpoints": checkpoints, "prev": prev}, "hash", _sha)
    if len(line) <= MAX_RECORD_LINE_BYTES:
        return line, hash
    params = body["params"]
    left_out = {"left_out": params.get("left_out", {"octets": len(line), "sha256": sha256(line).hexdigest()})}
    shorter = body | {"params": {**params, **left_out} if body["frames"] else left_out, "frames": []}
    return encode_record(n, prev, checkpoints, shorter)


def decode_record(line: bytes) -> AuditRecord | None:
    """Return the record of a line without line end; None if its form or its hash is wrong."""
    members = _verify_digest(line, "hash", _sha)
    if members is None:
        return None
    body, hash = members
    n, prev, checkpoints = body.pop("n", None), body.pop("prev", None), body.pop("checkpoints", None)
    if not all(type(number) is int for number in (n, checkpoints, body.get("time_ms"))) or not isinstance(prev, str):
        return None
    return AuditRecord(n, prev, hash, checkpoints, body)


def encode_checkpoint(number: int, last: tuple[int, str], prev: str, time_ms: int, key: bytes) -> tuple[bytes, str]:
    """Return a checkpoint's line, with its line end, and its MAC. ``last``: number and hash of the last record."""
    body = {"checkpoint": number, "n": last[0], "hash": last[1], "time_ms": time_ms, "prev": prev}
    return _append_digest(body, "mac", _mac(key))


def decode_checkpoint(line: bytes, key: bytes | None) -> AuditCheckpoint | None:
    """Return the checkpoint of a line; None if its form or its MAC under ``key`` is wrong.

    Without ``key`` only the form is checked.
    """
    members = _verify_digest(line, "mac", None if key is None else _mac(key))
    if members is None:
        return None
    body, mac = members
    try:
        checkpoint = AuditCheckpoint(
            number=body["checkpoint"],
            n=body["n"],
            hash=body["hash"],
            prev=body["prev"],
            mac=mac,
            time_ms=body["time_ms"],
        )
    except KeyError:
        return None
    numbers, words = (checkpoint.number, checkpoint.n, checkpoint.time_ms), (checkpoint.hash, checkpoint.prev)
    return (
        checkpoint
        if all(type(number) is int for number in numbers) and all(isinstance(word, str) for word in words)
        else None
    )


def _sha(data: bytes) -> str:
    return sha256(data).hexdigest()


def _mac(key: bytes) -> Callable[[bytes], str]:
    return lambda data: hmac.new(key, data, sha256).hexdigest()


def _append_digest(body: Json, name: str, digest: Callable[[bytes], str]) -> tuple[bytes, str]:
    data = json.dumps(body, separators=(",", ":"), allow_nan=False).encode("ascii")
    hexadecimal = digest(data)
    return data[:-1] + _digest_member(name, hexadecimal) + b"\n", hexadecimal


def _digest_member(name: str, digest: str) -> bytes:
    return f',"{name}":"{digest}"}}'.encode("ascii")


def _verify_digest(line: bytes, name: str, digest: Callable[[bytes], str] | None) -> tuple[dict[str, Any], str] | None:
    """Return body and digest of a line whose last member is ``name`` and matches every byte before it; else None."""
    size = len(_digest_member(name, "0" * _DIGEST_HEX_LENGTH))
    data, member = line[:-size] + b"}", line[-size:]
    try:
        hexadecimal = member[-_DIGEST_HEX_LENGTH - 2 : -2].decode("ascii")
        if member != _digest_member(name, hexadecimal):
            return None
        if digest is not None and not hmac.compare_digest(digest(data), hexadecimal):
            return None
        body = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return (body, hexadecimal) if isinstance(body, dict) else None
