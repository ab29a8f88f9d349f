"""A bus core can be copied and named: the copy goes its own way, and two cores with one name behave alike.

Every attribute of every object that a core is made of is listed here with how it enters the name. One that is new in
the bus and not listed is refused: it might make two states look alike that are not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from drivebus.bus.babble import Patience
from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoKeeper
from drivebus.bus.job import Job
from drivebus.bus.listener import Listener
from drivebus.bus.planner import Plan
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.stations import ProbeBudget, Station
from drivebus.bus.transaction import Transaction
from drivebus.message import Lane

SHARED = frozenset(
    {
        "activity", "ask", "asked", "codec", "counters", "error", "line", "_line", "link", "message", "permit", "plan",
        "prepared", "request",
    }
)  # fmt: skip
"""Not copied: values, what is only counted or looked at, and the plan, which is empty as long as nobody polls."""

PARTS: dict[type, dict[str, str]] = {
    BusCore: {
        "is_open": "same", "stations": "parts", "gone": "gone", "all_latched": "same", "scheduler": "parts",
        "listener": "parts", "echo": "parts", "flight": "parts", "_patience": "patience", "_quiet_since": "quiet",
        "_wake": "until", "_allow_mixed": "", "line": "", "name": "", "paced": "", "tracing": "", "opened_at": "",
        "begun_at": "", "counters": "", "activity": "", "character_s": "", "out": "",
    },
    Scheduler: {
        "lanes": "parts", "doubted": "owners", "refused": "many", "budget": "", "plan": "",
        "_urgent": "", "_commands": "", "_polls": "", "_stopped": "", "wake_at": "", "_line": "",
    },
    Station: {
        "latched": "same", "seen": "same", "dead": "same", "suspect": "same", "quarantined_until": "until",
        "probe_at": "until", "refusals": "same", "second_answers": "many", "parked": "many", "backoff_s": "",
        "unanswered": "", "doubted_at": "", "generation": "", "address": "", "codec": "", "counters": "",
        "fence_waiting": "", "asked": "", "asked_at": "", "answered": "", "fences": "", "gap_s": "",
        "last_heard_at": "", "link": "", "prepared": "",
    },
    Job: {
        "data": "data", "token": "same", "lane": "value", "attempts": "attempts", "attempts_allowed": "same",
        "expires_at": "until", "permit": "permit", "effect": "value", "station": "owner", "fence": "",
        "broadcast": "", "ask": "", "codec": "", "gap_s": "", "adapter_s": "", "remembered": "", "reply_bytes": "",
        "request": "", "send_s": "", "wait_s": "", "sent_at": "",
    },
    Transaction: {
        "job": "parts", "final_at": "until", "sent_end": "until", "message": "there", "error": "there",
        "heard": "same", "deadline": "", "buffer": "", "tentative": "", "size": "", "character_s": "", "early": "",
        "echo": "", "foreign": "", "glitched": "", "heard_at": "", "need": "", "paced": "", "sent_at": "",
    },
    EchoKeeper: {"proved": "same", "state": "", "_missing": "", "_mirrored": "", "detect": "", "count": ""},
    Listener: {"buffer": "many", "_foreign": "many", "heard_at": ""},
    Patience: {"_since": "", "_line": ""},
    Plan: {"_heap": "", "_count": "", "_phases": ""},
    ProbeBudget: {"allowed_at": ""},
}  # fmt: skip
"""Left out ("") is what is fixed for a bus or follows from what is named; what is only counted; the numbers of fences
(the campaign answers each fence with its own answer); what tells apart bytes that nobody asked for (there are none but
in the campaign of the wire); and the scheduler's counters of fairness, which decide between a command and a read or a
due fence, never whether a command may be sent at all."""


def _getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """All these attributes at once, as a tuple also where there are fewer than two."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda thing: tuple([getattr(thing, name) for name in names])


def unlisted(core: BusCore) -> list[str]:
    """Attributes of the bus that this module does not know."""
    found = {kind: set(getattr(kind, "__slots__", ())) for kind in PARTS} | {BusCore: set(vars(core))}
    return sorted(f"{kind.__name__}.{name}" for kind, names in found.items() for name in names - set(PARTS[kind]))


def copy(core: BusCore) -> BusCore:
    """Another core in the same state."""
    made: BusCore = _copied(core, {})
    return made


def _copied(thing: Any, memo: dict[int, Any]) -> Any:
    kind = type(thing)
    if kind in PARTS:
        found = memo.get(id(thing))
        if found is None:
            found = memo[id(thing)] = object.__new__(kind)
            slots = _SLOTS.get(kind)
            values = vars(thing).items() if slots is None else zip(slots, _GET[kind](thing), strict=True)
            for name, value in values:
                plain = type(value) in _PLAIN or name in SHARED
                setattr(found, name, value if plain else _copied(value, memo))
        return found
    if kind is list:
        kept = memo.get(id(thing))
        if kept is None:
            kept = memo[id(thing)] = [_copied(one, memo) for one in thing]
        return kept
    if kind is deque:
        return deque([_copied(one, memo) for one in thing]) if thing else deque()
    if kind is tuple:
        return tuple([_copied(one, memo) for one in thing])
    if kind is dict:
        return {_copied(key, memo): _copied(one, memo) for key, one in thing.items()}
    return bytearray(thing) if kind is bytearray else thing


def name(core: BusCore, now: float, far_s: float) -> tuple[Any, ...]:
    """What tells this state from others, all times relative to ``now``; beyond ``far_s`` they are all the same."""
    named: tuple[Any, ...] = _named(core, core, now, far_s)
    return named


def _named(thing: Any, owner: Any, now: float, far_s: float) -> Any:
    kind = type(thing)
    if thing is None:
        return None
    hows = _HOWS.get(kind)
    if hows is not None:
        values = _NAMED[kind](thing)
        return tuple([v if how is None else how(v, thing, now, far_s) for how, v in zip(hows, values, strict=True)])
    if kind is dict:
        return tuple([(key, _named(one, thing, now, far_s)) for key, one in thing.items()])
    return tuple([_named(one, thing, now, far_s) for one in thing]) if thing else ()


def until(when: float | None, owner: Any, now: float, far_s: float) -> float | None:
    """How long until then: 0 where it is past."""
    return None if when is None else 0.0 if when <= now else round(min(when - now, far_s), 6)


def _patience(patience: Patience, core: BusCore, now: float, _: float) -> float | None:
    """Since when a frame waits for silence: of no interest once the line is silent."""
    waits = patience._since is not None and now < core._quiet_since + core.line.seconds(1)
    return now - patience._since if waits and patience._since is not None else None


_RULES: dict[str, Callable[[Any, Any, float, float], Any] | None] = {
    "same": None,
    "parts": _named,
    "until": until,
    "quiet": lambda when, core, now, _: min(now - when, core.line.seconds(1)),
    "patience": _patience,
    "there": lambda one, thing, now, _: one is not None,
    "many": lambda ones, thing, now, _: len(ones),
    "attempts": lambda attempts, job, now, _: attempts if job.lane is not Lane.STOP else None,
    "value": lambda one, thing, now, _: one.value,
    "data": lambda data, job, now, _: b"" if job.fence else data,
    "owner": lambda station, job, now, _: station.latched if job.permit is not None else None,
    "owners": lambda stations, scheduler, now, _: [station.address for station in stations],
    "permit": lambda permit, job, now, _: permit and (permit.generation == job.station.generation, permit.effect.value),
    "gone": lambda gone, core, now, _: [(one, gone[one].latched) for one in sorted(gone) if one not in core.stations],
}
_PLAIN = frozenset({int, float, str, bytes, bool, type(None)})
_SLOTS = {kind: tuple(kind.__slots__) for kind in PARTS if hasattr(kind, "__slots__")}
_GET = {kind: _getter(list(slots)) for kind, slots in _SLOTS.items()}
_NAMED = {kind: _getter([name for name, how in listed.items() if how]) for kind, listed in PARTS.items()}
_HOWS = {kind: tuple(_RULES[how] for how in listed.values() if how) for kind, listed in PARTS.items()}
