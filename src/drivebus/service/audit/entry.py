"""What is recorded, and what of it may never be: secrets, endless texts. No file and no clock lives here."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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
