"""What is wrong with a profile beyond its shape: values that must fit each other. Gives problems, never raises."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivebus.line import LineSettings
from drivebus.profiles import bits, places
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.notation import nearest
from drivebus.profiles.schema import ProfileIn

ADDRESSES = {"sifang": (0, 30), "dzb": (1, 31), "modbus": (1, 247)}
"""Station addresses that a family's protocol can have; broadcast is not one of them."""
ENCODINGS = {"sifang": ("ascii", "hex"), "dzb": ("ascii",), "modbus": ("rtu", "ascii")}
STYLES = {"sifang": ("sifang",), "dzb": ("dzb",), "modbus": ("consecutive", "hundreds", "register")}
NEEDED_BITS = {
    "run": "start",
    "reverse": "reverse",
    "stop": "stop",
    "coast": "coast",
    "quick_stop": "quick_stop",
    "jog": "jog_forward",
    "reset_fault": "reset",
}
"""Capability of a Modbus model → the command it can't do without."""


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Everything that does not fit together; only the family's own where even that does not fit."""
    foreign = list(_family(profile))
    if foreign:
        yield from foreign
        return
    yield from _line(profile)
    yield from _addresses(profile)
    yield from _capabilities(profile)
    yield from places.problems(profile)
    yield from _ranges(profile)
    yield from _numbered(profile)
    yield from bits.problems(profile)
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
        yield problem("not_in", ("line", "format"), line.format, choices=_listed(line.formats))
    if line.baud not in line.bauds:
        yield problem("not_in", ("line", "baud"), line.baud, choices=_listed(line.bauds))
    if profile.limits.minimum_hz >= profile.limits.maximum_hz:
        also = (("limits", "maximum_hz"),)
        low, high = profile.limits.minimum_hz, profile.limits.maximum_hz
        yield problem("limits", ("limits", "minimum_hz"), low, also=also, maximum=high)


def _addresses(profile: ProfileIn) -> Iterator[Problem]:
    low, high = profile.addresses
    lowest, highest = ADDRESSES[profile.family]
    if not lowest <= low <= high <= highest:
        yield problem("addresses", ("addresses",), profile.addresses, lowest=lowest, highest=highest)
    if profile.broadcast is not None and low <= profile.broadcast <= high:
        also = (("addresses",),)
        yield problem("broadcast", ("broadcast",), profile.broadcast, also=also, low=low, high=high)


def _family(profile: ProfileIn) -> Iterator[Problem]:
    for encoding in profile.encodings:
        if encoding not in ENCODINGS[profile.family]:
            yield problem("choice", ("encodings",), encoding, choices=_listed(ENCODINGS[profile.family]))
    if profile.notation.style not in STYLES[profile.family]:
        choices = _listed(STYLES[profile.family])
        yield problem("choice", ("notation", "style"), profile.notation.style, also=(("family",),), choices=choices)


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
    yield from _modbus(profile)
    for bit in ("running", "fault"):
        if "status" in able and (profile.status is None or bit not in profile.status.bits):
            yield problem("needs", ("capabilities",), "status", what=f"[status.bits] {bit}")
    if profile.commands is None:
        return
    offered = set(profile.commands.bits).union(
        *(bits for choice in profile.commands.variants.values() for bits in choice.values())
    )
    for capability, bit in NEEDED_BITS.items():
        if capability in able and bit not in offered:
            yield problem("needs", ("capabilities",), capability, what=f"[commands.bits] {bit}")


def _modbus(profile: ProfileIn) -> Iterator[Problem]:
    """What is used must be among the functions that the model has."""
    functions = profile.modbus.functions if profile.modbus else []
    if profile.commands is not None and profile.commands.function not in functions:
        yield problem("not_in", ("commands", "function"), profile.commands.function, choices=_listed(functions))
    if "read" in profile.capabilities and 3 not in functions:
        also = (("modbus", "functions"),)
        yield problem("needs", ("capabilities",), "read", also=also, what="[modbus] functions 3")


def _ranges(profile: ProfileIn) -> Iterator[Problem]:
    entries = [(("signals", n), s) for n, s in profile.signals.items()]
    entries += [(("parameters", n), p) for n, p in profile.parameters.items()]  # type: ignore[misc]
    for path, entry in entries:
        if entry.minimum is not None and entry.maximum is not None and entry.minimum > entry.maximum:
            also = ((*path, "maximum"),)
            yield problem("minimum", (*path, "minimum"), entry.minimum, also=also, maximum=entry.maximum)
    for notation, parameter in profile.parameters.items():
        for raw in parameter.choices:
            if not _is_word(raw):
                yield problem("number", ("parameters", notation, "choices", raw), raw)
        if parameter.caveat is not None and parameter.caveat not in profile.caveats:
            known = _listed(profile.caveats)
            yield problem("choice", ("parameters", notation, "caveat"), parameter.caveat, choices=known)


def _numbered(profile: ProfileIn) -> Iterator[Problem]:
    for code in profile.faults:
        if not _is_word(code):
            yield problem("number", ("faults", code), code)


def _settings(profile: ProfileIn) -> Iterator[Problem]:
    """Settings answer open questions: no others, and only with their choices."""
    questions = {name: question for name, question in profile.open.items() if question.where is None}
    for name in profile.settings:
        if name not in questions:
            yield problem("unknown_key", ("settings", name), name, known=_listed(nearest(name, questions) or questions))
    for name, question in profile.open.items():
        value = profile.settings.get(name, question.default)
        path = ("settings", name) if name in profile.settings else ("open", name, "default")
        if question.choices and not any(value == c and type(value) is type(c) for c in question.choices):
            yield problem("choice", path, value, choices=_listed(question.choices))
    for setting, variants in profile.commands.variants.items() if profile.commands else ():
        known = [str(choice) for choice in questions[setting].choices] if setting in questions else []
        for value in variants:
            if value not in known:
                yield problem("choice", ("commands", "variants", setting, value), value, choices=_listed(known))


def _listed(values: Iterable[object]) -> str:
    return ", ".join(map(str, values)) or "-"


def _is_word(digits: str) -> bool:
    return digits.isascii() and digits.isdecimal() and int(digits) <= 0xFFFF
