"""What is wrong with a profile beyond its shape: values that must fit each other. Gives problems, never raises."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivebus.profiles import addressing, check_bits
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.notation import nearest_names
from drivebus.profiles.schema import OptionIn, ProfileIn
from drivebus.serial_settings import SerialSettings

FAMILY_ADDRESSES = {"sifang": (0, 30), "dzb": (1, 31), "modbus": (1, 247)}
"""Station addresses that a family's protocol can have; broadcast is not one of them."""
FAMILY_ENCODINGS = {"sifang": ("ascii", "hex"), "dzb": ("ascii",), "modbus": ("rtu", "ascii")}
FAMILY_NOTATION_STYLES = {"sifang": ("sifang",), "dzb": ("dzb",), "modbus": ("consecutive", "hundreds", "register")}
FAMILY_BROADCAST = {"sifang": 31, "dzb": 0, "modbus": 0}
"""The one address that every station of a family hears."""
FAMILY_GAP_CHARACTERS = {"sifang": 5.0, "dzb": 0.0, "modbus": 3.5}
"""Characters of silence without which a frame does not count (C320 manual §2.2.4; Modbus; DZB100: not published)."""
REQUIRED_COMMANDS = {
    "run": ("start",),
    "reverse": ("forward", "reverse"),
    "stop": ("stop",),
    "coast": ("coast",),
    "quick_stop": ("quick_stop",),
    "jog": ("jog_forward", "jog_stop"),
    "reset_fault": ("reset",),
}
"""Capability of a Modbus model → the commands it can't do without."""


def check_profile(profile: ProfileIn) -> Iterator[Issue]:
    """Everything that does not fit together; only the family's own where even that does not fit."""
    foreign = list(_check_family(profile))
    if foreign:
        yield from foreign
        return
    yield from _check_serial(profile)
    yield from _check_limits(profile)
    yield from _check_addresses(profile)
    yield from _check_capabilities(profile)
    yield from addressing.check_addressing(profile)
    yield from _check_ranges(profile)
    yield from _check_fault_codes(profile)
    yield from check_bits.check_bits(profile)
    yield from _check_options(profile)


def _check_serial(profile: ProfileIn) -> Iterator[Issue]:
    line = profile.line
    for index, text in enumerate([line.format, *line.formats]):
        path = ("line", "format") if index == 0 else ("line", "formats")
        try:
            SerialSettings.parse(9600, text)
        except ValueError:
            yield issue("line_format", path, text)
    if line.format not in line.formats:
        yield issue("not_in", ("line", "format"), line.format, choices=_join(line.formats))
    if line.baud not in line.bauds:
        yield issue("not_in", ("line", "baud"), line.baud, choices=_join(line.bauds))
    gap = FAMILY_GAP_CHARACTERS[profile.family]
    if profile.timing.gap_characters < gap:
        yield issue("range", ("timing", "gap_characters"), profile.timing.gap_characters, bound=f">= {gap}")


def _check_limits(profile: ProfileIn) -> Iterator[Issue]:
    """Upside down, or beyond what a setpoint's word can say."""
    low, high = profile.limits.minimum_hz, profile.limits.maximum_hz
    if low >= high:
        yield issue("limits", ("limits", "minimum_hz"), low, related=(("limits", "maximum_hz"),), maximum=high)
    word = 9999 if profile.setpoint.coding == "bcd" else 0xFFFF
    if high > word * profile.setpoint.factor:
        also = (("setpoint", "factor"),)
        bound = f"<= {word * profile.setpoint.factor:g}"
        yield issue("range", ("limits", "maximum_hz"), high, related=also, bound=bound)


def _check_addresses(profile: ProfileIn) -> Iterator[Issue]:
    low, high = profile.addresses
    lowest, highest = FAMILY_ADDRESSES[profile.family]
    if not lowest <= low <= high <= highest:
        yield issue("addresses", ("addresses",), profile.addresses, lowest=lowest, highest=highest)
    if profile.broadcast is not None and low <= profile.broadcast <= high:
        also = (("addresses",),)
        yield issue("broadcast", ("broadcast",), profile.broadcast, related=also, low=low, high=high)
    elif profile.broadcast is not None and profile.broadcast != FAMILY_BROADCAST[profile.family]:
        yield issue("choice", ("broadcast",), profile.broadcast, choices=FAMILY_BROADCAST[profile.family])


def _check_family(profile: ProfileIn) -> Iterator[Issue]:
    for encoding in profile.encodings:
        if encoding not in FAMILY_ENCODINGS[profile.family]:
            yield issue("choice", ("encodings",), encoding, choices=_join(FAMILY_ENCODINGS[profile.family]))
    if profile.notation.style not in FAMILY_NOTATION_STYLES[profile.family]:
        choices = _join(FAMILY_NOTATION_STYLES[profile.family])
        yield issue("choice", ("notation", "style"), profile.notation.style, related=(("family",),), choices=choices)


def _check_capabilities(profile: ProfileIn) -> Iterator[Issue]:
    able = set(profile.capabilities)
    if "broadcast_stop" in able and profile.broadcast is None:
        yield issue("needs", ("capabilities",), "broadcast_stop", what="broadcast")
    if "write_ram" in able and not profile.write.ram:
        yield issue("needs", ("capabilities",), "write_ram", what="write.ram = true")
    for moving in sorted(able & {"run", "jog"}):
        if "stop" not in able:
            yield issue("needs", ("capabilities",), moving, what="stop")
    if profile.family != "modbus":
        return
    for section in ("modbus", "commands"):
        if getattr(profile, section) is None:
            yield issue("missing_key", (section,), "-", name=section)
    yield from _check_modbus(profile)
    for bit in ("running", "fault"):
        if "status" in able and (profile.status is None or bit not in profile.status.bits):
            yield issue("needs", ("capabilities",), "status", what=f"[status.bits] {bit}")
    if profile.commands is None:
        return
    offered = set(profile.commands.bits).union(
        *(check_bits for choice in profile.commands.variants.values() for check_bits in choice.values())
    )
    for capability in sorted(able & REQUIRED_COMMANDS.keys()):
        for bit in REQUIRED_COMMANDS[capability]:
            if bit not in offered:
                yield issue("needs", ("capabilities",), capability, what=f"[commands.bits] {bit}")


def _check_modbus(profile: ProfileIn) -> Iterator[Issue]:
    """What is used must be among the functions that the model has."""
    functions = profile.modbus.functions if profile.modbus else []
    if profile.commands is not None and profile.commands.function not in functions:
        yield issue("not_in", ("commands", "function"), profile.commands.function, choices=_join(functions))
    if "read" in profile.capabilities and 3 not in functions:
        also = (("modbus", "functions"),)
        yield issue("needs", ("capabilities",), "read", related=also, what="[modbus] functions 3")


def _check_ranges(profile: ProfileIn) -> Iterator[Issue]:
    entries = [(("signals", n), s) for n, s in profile.signals.items()]
    entries += [(("parameters", n), p) for n, p in profile.parameters.items()]  # type: ignore[misc]
    for path, entry in entries:
        if entry.minimum is not None and entry.maximum is not None and entry.minimum > entry.maximum:
            also = ((*path, "maximum"),)
            yield issue("minimum", (*path, "minimum"), entry.minimum, related=also, maximum=entry.maximum)
    for notation, parameter in profile.parameters.items():
        for raw in parameter.choices:
            if not _is_word(raw):
                yield issue("number", ("parameters", notation, "choices", raw), raw)
        setting = parameter.maximum_setting
        numbers = [name for name, question in profile.open.items() if question.span and question.where is None]
        if setting is not None and setting not in numbers:
            where = ("parameters", notation, "maximum_setting")
            yield issue("choice", where, setting, choices=_join(numbers))
        if parameter.caveat is not None and parameter.caveat not in profile.caveats:
            known = _join(profile.caveats)
            yield issue("choice", ("parameters", notation, "caveat"), parameter.caveat, choices=known)


def _check_fault_codes(profile: ProfileIn) -> Iterator[Issue]:
    for code in profile.faults:
        if not _is_word(code):
            yield issue("number", ("faults", code), code)


def _check_options(profile: ProfileIn) -> Iterator[Issue]:
    """Settings answer open questions: no others, and only with their choices."""
    questions = {name: question for name, question in profile.open.items() if question.where is None}
    for name in profile.settings:
        if name not in questions:
            yield issue(
                "unknown_key", ("settings", name), name, known=_join(nearest_names(name, questions) or questions)
            )
    for name, question in profile.open.items():
        value = profile.settings.get(name, question.default)
        path = ("settings", name) if name in profile.settings else ("open", name, "default")
        if not _is_allowed(value, question):
            span = [f"{question.span[0]}-{question.span[1]}"] if question.span else []
            yield issue("choice", path, value, choices=_join([*question.choices, *span]))
    for setting, variants in profile.commands.variants.items() if profile.commands else ():
        known = [str(choice) for choice in questions[setting].choices] if setting in questions else []
        for value in variants:
            if value not in known:
                yield issue("choice", ("commands", "variants", setting, value), value, choices=_join(known))


def _is_allowed(value: object, question: OptionIn) -> bool:
    if question.span and type(value) is int and question.span[0] <= value <= question.span[1]:
        return True
    if not question.choices and not question.span:
        return True
    return any(value == choice and type(value) is type(choice) for choice in question.choices)


def _join(values: Iterable[object]) -> str:
    return ", ".join(map(str, values)) or "-"


def _is_word(digits: str) -> bool:
    """Written one way only: "01" beside "1" would be the same word twice."""
    return digits.isascii() and digits.isdecimal() and int(digits) <= 0xFFFF and digits == str(int(digits))
