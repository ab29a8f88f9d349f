"""What is recorded, and what of it may never be: secrets, endless texts. No file and no clock lives here."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from hashlib import sha256
from math import isfinite
from typing import Any, Final

from drivebus.plant.actor import Actor
from drivebus.plant.view import Json

SERVICE: Final = "drivebus"
"""Who did it where the service did."""
SECRET: Final = re.compile(
    r"password|passwd|passphrase|secret|token|cookie|csrf|credential|authorization|private_?key|^arm$|^code$", re.I
)
"""Names whose values are never written; ``arm`` and ``code`` open a door for ten seconds."""
LOGIN: Final = re.compile(r"(?<=://)[^/@\s]*@|\b(?<=Bearer )\S+")
"""A user and password in an address; a token in a header."""
HIDDEN: Final = "***"
LONGEST_TEXT: Final = 2_000
"""Characters; of a longer text (a whole configuration) its length and SHA-256 are kept."""
MOST_ITEMS: Final = 500
DEEPEST: Final = 8


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that somebody did or asked for. ``what`` is an operation, or ``login``, ``refused``, …"""

    what: str
    who: str = SERVICE
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
    def by(cls, actor: Actor, what: str, **more: Any) -> Entry:
        """What somebody did."""
        return cls(what, actor.name, actor.session, actor.address, **more)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Entry:
        """As another process sends it; members that nobody knows are kept among the parameters."""
        own = {name: found[name] for name in cls.__dataclass_fields__ if found.get(name) is not None}
        params = own.pop("params", {})
        more = {name: value for name, value in found.items() if name not in cls.__dataclass_fields__}
        whole = {**(params if isinstance(params, Mapping) else {"params": params}), **more}
        return cls(**{"what": "", **own}, params=whole)


def told(entry: Entry, time_ms: int) -> Json:
    """What is written of it, secrets hidden."""
    who = {"name": entry.who, "session": entry.session, "address": entry.address}
    return {
        "time_ms": time_ms, "who": clean(who), "what": clean(entry.what), "target": clean(entry.target),
        "params": clean(entry.params), "frames": clean(entry.frames), "outcome": clean(entry.outcome),
        "of": clean(entry.of),
    }  # fmt: skip


def clean(value: Any, depth: int = 0) -> Any:
    """The value as JSON, without secrets, of bounded length."""
    if isinstance(value, Enum):
        value = value.value
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else str(value)
    if isinstance(value, bytes | bytearray):
        value = bytes(value).hex(" ").upper()
    if depth < DEEPEST and isinstance(value, Mapping):
        return {_text(str(name))[:100]: _hidden(str(name), one, depth) for name, one in [*value.items()][:MOST_ITEMS]}
    if depth < DEEPEST and isinstance(value, list | tuple | set | frozenset):
        return [clean(one, depth + 1) for one in list(value)[:MOST_ITEMS]]
    return _short(_text(str(value)))


def _hidden(name: str, value: Any, depth: int) -> Any:
    return HIDDEN if SECRET.search(name) and value is not None else clean(value, depth + 1)


def _text(text: str) -> str:
    """No password of an address, no half of a character."""
    return LOGIN.sub(lambda found: HIDDEN + "@" if found[0].endswith("@") else HIDDEN, text).encode(
        "utf-8", "backslashreplace"
    ).decode()  # fmt: skip


def _short(text: str) -> Any:
    if len(text) <= LONGEST_TEXT:
        return text
    return {"characters": len(text), "sha256": sha256(text.encode()).hexdigest()}
