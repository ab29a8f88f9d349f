"""Copy and key of a bus core: a copy is independent, and two cores with the same key behave alike.

Every attribute of every object of a core is listed here with its part in the key. The campaign rejects an unlisted
attribute, which could make two different states look alike.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoDetector
from drivebus.bus.messages import RequestPriority
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.scheduler import PollSchedule, Scheduler
from drivebus.bus.silence_timeout import SilenceTimeout
from drivebus.bus.station import ProbeBudget, Station
from drivebus.bus.station_registry import StationRegistry
from drivebus.bus.transaction import Transaction
from drivebus.bus.unsolicited import MAX_FRAGMENT_PAUSE_S, UnsolicitedBytes

SHARED_ATTRIBUTES = frozenset(
    {
        "activity",
        "bus_request",
        "last_request",
        "codec",
        "counters",
        "_counters",
        "error",
        "settings",
        "_settings",
        "config",
        "message",
        "permit",
        "poll_schedule",
        "encode_cache",
        "request",
        "usual_delay",
    }
)
"""Attributes that are not copied: values, counters, and the poll schedule, which is empty here."""

NAMED_ATTRIBUTES: dict[type, dict[str, str]] = {
    BusCore: {
        "is_open": "same",
        "_closed_by": "",
        "registry": "parts",
        "stations": "",
        "scheduler": "parts",
        "unsolicited": "parts",
        "echo": "parts",
        "transaction": "parts",
        "_silence_timeout": "silence timeout",
        "_silent_since": "quiet",
        "wake_at": "until",
        "settings": "",
        "name": "",
        "has_line_timing": "",
        "learns_delays": "",
        "tracing": "",
        "opened_at": "",
        "first_opened_at": "",
        "counters": "",
        "activity": "",
        "character_s": "",
        "_commands": "",
    },
    StationRegistry: {
        "stations": "parts",
        "removed": "gone",
        "all_starts_inhibited": "same",
        "_allow_mixed": "",
        "_settings": "",
    },
    Scheduler: {
        "queues": "parts",
        "untrusted_stations": "owners",
        "rejected": "many",
        "probe_budget": "",
        "poll_schedule": "",
        "_urgent_in_row": "",
        "_commands_in_row": "",
        "_stop_reads_in_row": "",
        "_polls_in_row": "",
        "_last_stop_at": "",
        "_pending_sync_probes": "",
        "next_wake_at": "",
        "_settings": "",
    },
    Station: {
        "start_inhibited": "same",
        "state": "name",
        "quarantined_until": "until",
        "next_probe_at": "until",
        "sync_rejections": "same",
        "duplicate_reply_times": "many",
        "probe_backoff_s": "",
        "unanswered_requests": "",
        "suspect_since": "",
        "contact_losses": "",
        "stop_epoch": "",
        "motions_sent": "",
        "address": "",
        "codec": "",
        "counters": "",
        "last_request": "",
        "last_request_sent_at": "",
        "last_request_answered": "",
        "sync_probe_count": "",
        "gap_s": "",
        "last_reply_at": "",
        "last_frame": "",
        "failure_reason": "",
        "earlier_failure_reason": "",
        "unusable_reply": "",
        "config": "",
        "encode_cache": "",
        "usual_delay": "",
    },
    PreparedRequest: {
        "data": "data",
        "token": "same",
        "priority": "value",
        "attempts": "attempts",
        "max_attempts": "same",
        "expires_at": "until",
        "permit": "permit",
        "effect": "value",
        "station": "owner",
        "is_sync_probe": "",
        "is_broadcast": "",
        "bus_request": "",
        "gap_s": "",
        "cacheable": "",
        "reply_bytes": "",
        "request": "",
        "send_s": "",
        "reply_timeout_s": "",
        "sent_at": "",
        "usual_delay": "",
    },
    Transaction: {
        "prepared": "parts",
        "ends_at": "until",
        "tx_end_at": "until",
        "message": "there",
        "error": "there",
        "received_count": "same",
        "deadline": "",
        "buffer": "",
        "needs_silence": "",
        "expected_result": "",
        "message_size": "",
        "character_s": "",
        "bytes_before_tx_end": "",
        "echo": "",
        "foreign_frames": "",
        "noise_skipped": "",
        "last_byte_at": "",
        "bytes_needed": "",
        "has_line_timing": "",
        "sent_at": "",
    },
    EchoDetector: {
        "ruled_out": "same",
        "state": "",
        "_initial_state": "",
        "_is_assumed": "",
        "_missing_echoes": "",
        "_mirrored_frame": "",
        "autodetect": "",
        "echo_count": "",
    },
    UnsolicitedBytes: {
        "buffer": "many",
        "_foreign_request_times": "many",
        "foreign_request": "foreign request",
        "last_byte_at": "",
        "_fragment": "fragment",
        "_fragment_at": "",
        "_stations": "",
        "_scheduler": "",
        "_counters": "",
        "_settings": "",
    },
    SilenceTimeout: {"_started_at": "", "_settings": ""},
    PollSchedule: {"heap": "", "_count": "", "_phase_count": "", "suspended": ""},
    ProbeBudget: {"allowed_at": ""},
}
"""Attributes with their rule in the key; "" leaves out what is fixed, derived or only counted.

Also left out: the numbers of sync probes (each is answered), the details of unsolicited bytes (only ``wire_state`` has
them), and the scheduler's fairness counters, which never decide whether a command may be sent.
"""


def _getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a getter of these attributes as a tuple, also for fewer than two."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda thing: tuple([getattr(thing, name) for name in names])


def unlisted_attributes(core: BusCore) -> list[str]:
    """Return attributes of the bus that this module does not list."""
    found = {kind: set(getattr(kind, "__slots__", ())) for kind in NAMED_ATTRIBUTES} | {BusCore: set(vars(core))}
    return sorted(
        f"{kind.__name__}.{name}" for kind, names in found.items() for name in names - set(NAMED_ATTRIBUTES[kind])
    )


def copy_core(core: BusCore) -> BusCore:
    """Return an independent core in the same state."""
    made: BusCore = _copy_object(core, {})
    return made


def _copy_object(thing: Any, memo: dict[int, Any]) -> Any:
    kind = type(thing)
    if kind in NAMED_ATTRIBUTES:
        found = memo.get(id(thing))
        if found is None:
            found = memo[id(thing)] = object.__new__(kind)
            slots = _SLOTS.get(kind)
            values = vars(thing).items() if slots is None else zip(slots, _COPY_GETTERS[kind](thing), strict=True)
            for name, value in values:
                plain = type(value) in _PLAIN or name in SHARED_ATTRIBUTES
                setattr(found, name, value if plain else _copy_object(value, memo))
        return found
    if kind is list:
        copied = memo.get(id(thing))
        if copied is None:
            copied = memo[id(thing)] = [_copy_object(item, memo) for item in thing]
        return copied
    if kind is deque:
        return deque([_copy_object(item, memo) for item in thing]) if thing else deque()
    if kind is tuple:
        return tuple([_copy_object(item, memo) for item in thing])
    if kind is dict:
        copied = memo.get(id(thing))
        if copied is None:
            copied = memo[id(thing)] = {}
            copied.update({_copy_object(key, memo): _copy_object(item, memo) for key, item in thing.items()})
        return copied
    return bytearray(thing) if kind is bytearray else thing


def state_key(core: BusCore, now: float, far_s: float) -> tuple[Any, ...]:
    """Return the key of a state, with times relative to ``now`` and limited to ``far_s``."""
    named: tuple[Any, ...] = _state_key(core, core, now, far_s)
    return named


def _state_key(value: Any, owner: Any, now: float, far_s: float) -> Any:
    kind = type(value)
    if value is None:
        return None
    rules = _KEY_RULES.get(kind)
    if rules is not None:
        values = _KEY_GETTERS[kind](value)
        return tuple([v if rule is None else rule(v, value, now, far_s) for rule, v in zip(rules, values, strict=True)])
    if kind is dict:
        return tuple([(key, _state_key(item, value, now, far_s)) for key, item in value.items()])
    return tuple([_state_key(item, value, now, far_s) for item in value]) if value else ()


def time_until(when: float | None, owner: Any, now: float, far_s: float) -> float | None:
    """Return the remaining time; 0 where it is over."""
    return None if when is None else 0.0 if when <= now else round(min(when - now, far_s), 6)


def _silence_key(silence_timeout: SilenceTimeout, core: BusCore, now: float, _: float) -> float | None:
    """Return how long a frame has waited for silence; None once the line is silent."""
    waits = silence_timeout._started_at is not None and now < core._silent_since + core.settings.seconds(1)
    return now - silence_timeout._started_at if waits and silence_timeout._started_at is not None else None


_RULES: dict[str, Callable[[Any, Any, float, float], Any] | None] = {
    "same": None,
    "parts": _state_key,
    "until": time_until,
    "quiet": lambda when, core, now, _: min(now - when, core.settings.seconds(1)),
    "silence timeout": _silence_key,
    "foreign request": lambda request, thing, now, far_s: (
        request and (request.address, time_until(request.reply_until, request, now, far_s))
    ),
    "fragment": lambda data, thing, now, _: data if now - thing._fragment_at <= MAX_FRAGMENT_PAUSE_S else b"",
    "there": lambda value, thing, now, _: value is not None,
    "many": lambda ones, thing, now, _: len(ones),
    "attempts": lambda attempts, prepared, now, _: attempts if prepared.priority is not RequestPriority.STOP else None,
    "value": lambda member, thing, now, _: member.value,
    "name": lambda member, thing, now, _: member.name,
    "data": lambda data, prepared, now, _: b"" if prepared.is_sync_probe else data,
    "owner": lambda station, prepared, now, _: station.start_inhibited if prepared.permit is not None else None,
    "owners": lambda stations, scheduler, now, _: [station.address for station in stations],
    "permit": lambda permit, prepared, now, _: (
        permit and (permit.stop_epoch == prepared.station.stop_epoch, permit.effect.value)
    ),
    "gone": lambda gone, registry, now, _: [
        (address, gone[address].start_inhibited) for address in sorted(gone) if address not in registry.stations
    ],
}
_PLAIN = frozenset({int, float, str, bytes, bool, type(None)})
_SLOTS = {kind: tuple(kind.__slots__) for kind in NAMED_ATTRIBUTES if hasattr(kind, "__slots__")}
_COPY_GETTERS = {kind: _getter(list(slots)) for kind, slots in _SLOTS.items()}
_KEY_GETTERS = {
    kind: _getter([name for name, rule in listed.items() if rule]) for kind, listed in NAMED_ATTRIBUTES.items()
}
_KEY_RULES = {
    kind: tuple(_RULES[rule] for rule in listed.values() if rule) for kind, listed in NAMED_ATTRIBUTES.items()
}
