"""What is wrong with a profile beyond its shape: values that must fit each other. Pure; gives problems, never raises.

Also turns pydantic's findings into the same problems.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from pydantic import ValidationError

from drivebus.errors import ProfileError
from drivebus.line import LineSettings
from drivebus.profiles.complaint import Problem, both, problem
from drivebus.profiles.model import NotationRule
from drivebus.profiles.notation import locate, nearest
from drivebus.profiles.schema import BitIn, ParameterIn, ProfileIn, SignalIn

_TYPES = {
    "int_type": "integer",
    "int_from_float": "integer",
    "float_type": "number",
    "string_type": "string",
    "bool_type": "boolean",
    "list_type": "array",
    "dict_type": "table",
    "model_type": "table",
}
"""pydantic's type faults → TOML's own words for types, i18n ``profiles.type.<word>``."""
_RANGES = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}


def from_pydantic(error: ValidationError) -> list[Problem]:
    """One problem for each fault that pydantic names, unions counted once."""
    found: dict[tuple[str | int, ...], Problem] = {}
    for fault in error.errors(include_url=False):
        path = tuple(part for part in fault["loc"] if part not in ("[key]", "str", "int", "float", "bool"))
        found.setdefault(path, _translated(fault, path))
    return list(found.values())


def _translated(fault: Any, path: tuple[str | int, ...]) -> Problem:
    kind, value, ctx = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return problem("unknown_key", path, path[-1], known=", ".join(_known_keys(path)))
    if kind == "missing":
        return problem("missing_key", path, "-", name=path[-1])
    if kind == "literal_error":
        if path[0] == "commands" and "toggle" in str(value):
            return problem("toggle", path, value)
        return problem("choice", path, value, choices=ctx["expected"])
    if kind in _RANGES:
        bound = next(iter(ctx.values()))
        return problem("range", path, value, bound=f"{_RANGES[kind]} {bound}")
    if kind in ("too_short", "too_long", "string_too_short"):
        few = ctx.get("min_length", 0)
        return problem("length", path, value, bound=f">= {few}" if "min_length" in ctx else f"<= {ctx['max_length']}")
    if kind == "string_pattern_mismatch":
        return problem("pattern", path, value, pattern=ctx["pattern"])
    return problem("type", path, value, type=both(f"profiles.type.{_TYPES.get(kind, 'other')}"))


def _known_keys(path: tuple[str | int, ...]) -> list[str]:
    """The keys that the table of an unknown one may have; those that look like it where some do."""
    model: Any = ProfileIn
    for part in path[:-1]:
        model = _below(model, part)
        if model is None:
            return []
    fields = [info.alias or name for name, info in model.model_fields.items()]
    return nearest(str(path[-1]), fields) or sorted(fields)


def _below(model: Any, part: str | int) -> Any:
    """The model of a table's value, through Optional and dict."""
    fields = getattr(model, "model_fields", None)
    if fields is None:
        return None
    info = next((f for name, f in fields.items() if (f.alias or name) == part), None)
    return _model_in(info.annotation) if info else model


def _model_in(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    inner = (_model_in(argument) for argument in getattr(annotation, "__args__", ()))
    return next((found for found in inner if found is not None), None)


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Everything that does not fit together."""
    yield from _line(profile)
    yield from _addresses(profile)
    yield from _capabilities(profile)
    yield from _group_sizes(profile)
    yield from _places(profile)
    yield from _preconditions(profile)
    yield from _ranges(profile)
    yield from _numbered(profile)
    yield from _commands(profile)
    yield from _status(profile)
    yield from _settings(profile)


def _line(profile: ProfileIn) -> Iterator[Problem]:
    line = profile.line
    for index, text in enumerate([line.format, *line.formats]):
        path = ("line", "format") if index == 0 else ("line", "formats")
        try:
            LineSettings.parse(9600, text)
        except ValueError:
            yield problem("line_format", path, text)
    if line.format not in line.formats:
        yield problem("not_in", ("line", "format"), line.format, choices=", ".join(line.formats))
    if line.baud not in line.bauds:
        yield problem("not_in", ("line", "baud"), line.baud, choices=", ".join(map(str, line.bauds)))
    if profile.limits.minimum_hz >= profile.limits.maximum_hz:
        yield problem("limits", ("limits", "minimum_hz"), profile.limits.minimum_hz, maximum=profile.limits.maximum_hz)


def _addresses(profile: ProfileIn) -> Iterator[Problem]:
    low, high = profile.addresses
    if low > high:
        yield problem("addresses", ("addresses",), profile.addresses)
    if profile.broadcast is not None and low <= profile.broadcast <= high:
        yield problem("broadcast", ("broadcast",), profile.broadcast, low=low, high=high)


def _capabilities(profile: ProfileIn) -> Iterator[Problem]:
    able = set(profile.capabilities)
    if "broadcast_stop" in able and profile.broadcast is None:
        yield problem("needs", ("capabilities",), "broadcast_stop", what="broadcast")
    if "write_ram" in able and not profile.write.ram:
        yield problem("needs", ("capabilities",), "write_ram", what="write.ram = true")
    if profile.family != "modbus":
        return
    for section in ("modbus", "commands"):
        if getattr(profile, section) is None:
            yield problem("missing_key", (section,), "-", name=section)
    if "status" in able and profile.status is None:
        yield problem("needs", ("capabilities",), "status", what="[status]")
    if profile.commands is None:
        return
    offered = set(profile.commands.bits).union(
        *(bits for choice in profile.commands.variants.values() for bits in choice.values())
    )
    needed = {"run": "start", "reverse": "reverse", "stop": "stop", "coast": "coast", "quick_stop": "quick_stop"}
    needed |= {"jog": "jog_forward", "reset_fault": "reset"}
    for capability, bit in needed.items():
        if capability in able and bit not in offered:
            yield problem("needs", ("capabilities",), capability, what=f"[commands.bits] {bit}")


def _group_sizes(profile: ProfileIn) -> Iterator[Problem]:
    for name in profile.group_sizes:
        if len(name) != 3 or name[0] != "F" or not name[1:].isdecimal():
            yield problem("group", ("group_sizes", name), name)
            return
    total = sum(profile.group_sizes.values())
    if profile.notation.style == "consecutive" and total > profile.notation.highest + 1:
        yield problem("group_total", ("group_sizes",), total, most=profile.notation.highest + 1)


def place(profile: ProfileIn, notation: str, register: int | None) -> tuple[str, int] | Problem | ProfileError:
    """The locator; a problem where the notation is wrong; the error ``profiles.unplaced`` where data is lacking."""
    if register is not None:
        return "holding", register
    rule = NotationRule(profile.notation.style, profile.notation.highest)
    try:
        return locate(notation, rule, profile.group_sizes)
    except ProfileError as error:
        if error.key == "profiles.notation":
            return problem("notation", (), notation, examples=error.params["examples"])
        return error if error.key == "profiles.unplaced" else problem("beyond", (), notation, **error.params)


def _places(profile: ProfileIn) -> Iterator[Problem]:
    """Notations that can't be, addresses outside the space, and two entries at one address."""
    taken: dict[tuple[str, int], str] = {}
    entries: list[tuple[tuple[str, str], str, SignalIn | ParameterIn]] = [
        *((("signals", name), signal.notation, signal) for name, signal in profile.signals.items()),
        *((("parameters", notation), notation, parameter) for notation, parameter in profile.parameters.items()),
    ]
    for path, notation, entry in entries:
        at = path if path[0] == "parameters" else (*path, "notation")
        if entry.register_ is not None and profile.family != "modbus":
            yield problem("register", (*path, "register"), entry.register_, family=profile.family)
            continue
        place_ = place(profile, notation, entry.register_)
        if isinstance(place_, Problem):
            yield problem(place_.kind, at, notation, **place_.params)
        elif isinstance(place_, tuple):
            other = taken.setdefault(place_, path[1])
            if other != path[1]:
                yield problem("duplicate", at, notation, other=other)


def _preconditions(profile: ProfileIn) -> Iterator[Problem]:
    named: set[tuple[tuple[str, ...], str]] = {(("preconditions", n), n) for n in profile.preconditions}
    named |= {(("roles", role), n) for role, n in profile.roles.items()}
    named |= {(("comm_loss", key), n) for key in ("time", "action") if (n := getattr(profile.comm_loss, key))}
    named |= {(("ramp",), n) for n in profile.ramp or ()}
    for path, notation in sorted(named):
        if notation not in profile.parameters:
            near = ", ".join(nearest(notation, profile.parameters)) or "-"
            yield problem("unlisted", path, notation, near=near)


def _ranges(profile: ProfileIn) -> Iterator[Problem]:
    entries = [(("signals", n), s) for n, s in profile.signals.items()]
    entries += [(("parameters", n), p) for n, p in profile.parameters.items()]  # type: ignore[misc]
    for path, entry in entries:
        if entry.minimum is not None and entry.maximum is not None and entry.minimum > entry.maximum:
            yield problem("minimum", (*path, "minimum"), entry.minimum, maximum=entry.maximum)
    for notation, parameter in profile.parameters.items():
        for raw in parameter.choices:
            if not raw.isdecimal() or int(raw) > 0xFFFF:
                yield problem("number", ("parameters", notation, "choices", raw), raw)
        if parameter.caveat is not None and parameter.caveat not in profile.caveats:
            known = ", ".join(profile.caveats)
            yield problem("choice", ("parameters", notation, "caveat"), parameter.caveat, choices=known)


def _numbered(profile: ProfileIn) -> Iterator[Problem]:
    for code in profile.faults:
        if not code.isdecimal() or int(code) > 0xFFFF:
            yield problem("number", ("faults", code), code)


def _commands(profile: ProfileIn) -> Iterator[Problem]:
    commands = profile.commands
    if commands is None:
        return
    groups: list[tuple[tuple[str, ...], dict[Any, BitIn]]] = [(("commands", "bits"), dict(commands.bits))]
    for setting, choices in commands.variants.items():
        for value, bits in choices.items():
            groups.append((("commands", "variants", setting, value), dict(bits)))
    for path, bits in groups:
        for name, bit in bits.items():
            if bit.value & ~bit.mask:
                yield problem("outside_mask", (*path, name), f"{bit.value:04X}H", mask=f"{bit.mask:04X}H")
            if name in ("forward", "reverse") and bit.mask.bit_count() > 1 and bit.value == bit.mask:
                yield problem("toggle", (*path, name), f"{bit.value:04X}H")
        yield from _overlaps(path, bits)


def _overlaps(path: tuple[str, ...], bits: dict[Any, BitIn]) -> Iterator[Problem]:
    """Two pulses may share a mask only as two values of one field; a pulse shares nothing with a level."""
    for (first, a), (second, b) in combinations(bits.items(), 2):
        if not a.mask & b.mask or not (a.pulse or b.pulse):
            continue
        if a.mask != b.mask or a.pulse != b.pulse or (a.value == b.value and not _same_stop(first, second)):
            yield problem("overlap", (*path, second), f"{b.mask:04X}H", other=first, mask=f"{a.mask:04X}H")


def _same_stop(first: str, second: str) -> bool:
    """A jog may be ended by the ordinary stop (DF800)."""
    return {first, second} == {"stop", "jog_stop"}


def _status(profile: ProfileIn) -> Iterator[Problem]:
    if profile.status is None:
        return
    seen = profile.status.reserved_mask
    for name, mask in profile.status.bits.items():
        if mask.bit_count() != 1 or mask & seen:
            yield problem("status_bit", ("status", "bits", name), f"{mask:04X}H", seen=f"{seen:04X}H")
        seen |= mask


def _settings(profile: ProfileIn) -> Iterator[Problem]:
    for name, question in profile.open.items():
        value = profile.settings.get(name, question.default)
        path = ("settings", name) if name in profile.settings else ("open", name, "default")
        if question.choices and value not in question.choices:
            yield problem("choice", path, value, choices=", ".join(map(str, question.choices)))
    for setting in profile.commands.variants if profile.commands else ():
        if setting not in profile.open and setting not in profile.settings:
            yield problem("missing_key", ("open", setting), "-", name=setting)
