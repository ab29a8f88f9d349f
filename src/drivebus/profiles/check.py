"""What is wrong with a profile beyond its shape: values that must fit each other. Gives problems, never raises."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivebus.line import LineSettings
from drivebus.profiles import bits, places
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.notation import nearest
from drivebus.profiles.schema import OpenIn, ProfileIn

ADDRESSES = {"sifang": (0, 30), "dzb": (1, 31), "modbus": (1, 247)}
"""Station addresses that a family's protocol can have; broadcast is not one of them."""
ENCODINGS = {"sifang": ("ascii", "hex"), "dzb": ("ascii",), "modbus": ("rtu", "ascii")}
STYLES = {"sifang": ("sifang",), "dzb": ("dzb",), "modbus": ("consecutive", "hundreds", "register")}
BROADCAST = {"sifang": 31, "dzb": 0, "modbus": 0}
"""The one address that every station of a family hears."""
GAPS = {"sifang": 5.0, "dzb": 0.0, "modbus": 3.5}
"""Characters of silence without which a frame does not count (C320 manual §2.2.4; Modbus; DZB100: not published)."""
NEEDED_BITS = {
    "run": ("start",),
    "reverse": ("forward", "reverse"),
    "stop": ("stop",),
    "coast": ("coast",),
    "quick_stop": ("quick_stop",),
    "jog": ("jog_forward", "jog_stop"),
    "reset_fault": ("reset",),
}
"""Capability of a Modbus model → the commands it can't do without."""


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Everything that does not fit together; only the family's own where even that does not fit."""
    foreign = list(_family(profile))
    if foreign:
        yield from foreign
        return
    yield from _line(profile)
    yield from _limits(profile)
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
    gap = GAPS[profile.family]
    if profile.timing.gap_characters < gap:
        yield problem("range", ("timing", "gap_characters"), profile.timing.gap_characters, bound=f">= {gap}")


def _limits(profile: ProfileIn) -> Iterator[Problem]:
    """Upside down, or beyond what a setpoint's word can say."""
    low, high = profile.limits.minimum_hz, profile.limits.maximum_hz
    if low >= high:
        yield problem("limits", ("limits", "minimum_hz"), low, also=(("limits", "maximum_hz"),), maximum=high)
    word = 9999 if profile.setpoint.coding == "bcd" else 0xFFFF
    if high > word * profile.setpoint.factor:
        also = (("setpoint", "factor"),)
        bound = f"<= {word * profile.setpoint.factor:g}"
        yield problem("range", ("limits", "maximum_hz"), high, also=also, bound=bound)


def _addresses(profile: ProfileIn) -> Iterator[Problem]:
    low, high = profile.addresses
    lowest, highest = ADDRESSES[profile.family]
    if not lowest <= low <= high <= highest:
        yield problem("addresses", ("addresses",), profile.addresses, lowest=lowest, highest=highest)
    if profile.broadcast is not None and low <= profile.broadcast <= high:
        also = (("addresses",),)
        yield problem("broadcast", ("broadcast",), profile.broadcast, also=also, low=low, high=high)
    elif profile.broadcast is not None and profile.broadcast != BROADCAST[profile.family]:
        yield problem("choice", ("broadcast",), profile.broadcast, choices=BROADCAST[profile.family])


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
    for moving in sorted(able & {"run", "jog"}):
        if "stop" not in able:
            yield problem("needs", ("capabilities",), moving, what="stop")
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
    for capability in sorted(able & NEEDED_BITS.keys()):
        for bit in NEEDED_BITS[capability]:
            if bit not in offered:
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
        setting = parameter.maximum_setting
        numbers = [name for name, question in profile.open.items() if question.span and question.where is None]
        if setting is not None and setting not in numbers:
            where = ("parameters", notation, "maximum_setting")
            yield problem("choice", where, setting, choices=_listed(numbers))
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
        if not _allowed(value, question):
            span = [f"{question.span[0]}-{question.span[1]}"] if question.span else []
            yield problem("choice", path, value, choices=_listed([*question.choices, *span]))
    for setting, variants in profile.commands.variants.items() if profile.commands else ():
        known = [str(choice) for choice in questions[setting].choices] if setting in questions else []
        for value in variants:
            if value not in known:
                yield problem("choice", ("commands", "variants", setting, value), value, choices=_listed(known))


def _allowed(value: object, question: OpenIn) -> bool:
    if question.span and type(value) is int and question.span[0] <= value <= question.span[1]:
        return True
    if not question.choices and not question.span:
        return True
    return any(value == choice and type(value) is type(choice) for choice in question.choices)


def _listed(values: Iterable[object]) -> str:
    return ", ".join(map(str, values)) or "-"


def _is_word(digits: str) -> bool:
    """Written one way only: "01" beside "1" would be the same word twice."""
    return digits.isascii() and digits.isdecimal() and int(digits) <= 0xFFFF and digits == str(int(digits))
