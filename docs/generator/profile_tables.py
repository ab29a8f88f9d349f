"""Tables of a profile: serial settings, keypad, signals, parameters, commands, faults, caveats, open questions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from drivebus import i18n
from drivebus.profiles import DriveProfile
from drivebus.profiles.model import OpenQuestion, Parameter, Signal
from drivebus.profiles.spaces import BIT_SPACES
from drivebus.profiles.words import CommandBit, CommandMap, WordMatch
from drivebus.values import Text
from generator.terms import BITS, colon, evidence, localized, table, term

COILS = Text("coils {first} to {last}, the first is bit 0", "线圈 {first}～{last}，第一个为位 0")
SINGLE_COIL = Text("one coil for each command, switched on", "每个命令一个线圈，置为 ON")
LAST_LISTED_NUMBER = 99  # greatest number of a list of commands or states; larger words are bits
PREPARATION = Text(
    "Words before a start, each sent in the status that asks for it:", "启动前的控制字，仅在状态字要求时发送："
)
UNLOCK = Text(
    "{value} is written to {place} before a start, and where the drive rejects a stop.",
    "启动前以及变频器拒绝停机时，向 {place} 写 {value}。",
)
EVERY_START = Text("Word before every start: {words}", "每次启动前的控制字：{words}")
MATCH = Text("status & {mask} = {value}", "状态字 & {mask} = {value}")
READY = Text("A start is sent where {ready}.", "{ready} 时才发送启动。")
RESET_ON_EDGE = Text("The stop word is sent before the reset.", "复位前先发送停机字。")
STANDSTILL = Text(
    "The motor counts as stopped once the output frequency reads 0 too.", "输出频率也读到 0 后才视为停机。"
)
CHOICES = Text(" ({choices})", "（{choices}）")
IDENTITY = Text("Register {register:04X}H tells the model from others.", "寄存器 {register:04X}H 用于区分型号。")


def serial_settings(profile: DriveProfile, language: str) -> str:
    """Return serial settings, timing and limits, with their evidence."""
    return table([term(head, language) for head in ("what", "value", "source")], _serial_rows(profile, language))


def _serial_rows(profile: DriveProfile, language: str) -> list[tuple[str, str, str]]:
    where = {name: evidence(found, language) for name, found in profile.evidence.items()}
    low, high = profile.addresses
    timing, serial = profile.timing, profile.serial
    broadcast = str(profile.broadcast) if profile.broadcast is not None else term("none", language)
    gap = f"{timing.gap_characters:g} {term('characters', language)}"
    if timing.gap_floor_s:
        floor = f"{term('never_less', language)} {timing.gap_floor_s * 1000:g} ms"
        gap = i18n.join((gap, floor), "phrases", language)
    reply = f"{timing.reply_delay_s * 1000:g} ms" if timing.reply_delay_s else ""
    if timing.reply_delay_characters:
        reply += f"{' + ' if reply else ''}{timing.reply_delay_characters:g} {term('characters', language)}"
    limits = f"{profile.limits.minimum_hz:g}–{profile.limits.maximum_hz:g} Hz"
    writes = term("ram_and_eeprom" if profile.write_support.ram else "eeprom_only", language)
    loss = profile.comm_loss
    notations = (("time", loss.time_notation), ("action", loss.action_notation))
    lost = i18n.join(
        (f"{term(word, language)} {notation}" for word, notation in notations if notation), "phrases", language
    )
    first = profile.encodings[0] + term("default_encoding", language)
    return [
        (term("encodings", language), i18n.join([first, *profile.encodings[1:]], "items", language), ""),
        (term("addresses", language), f"{low}–{high}", ""),
        (term("broadcast", language), broadcast, ""),
        (term("baud_rates", language), _marked(serial.bauds, serial.baud, language), where["serial"]),
        (term("formats", language), _marked(serial.formats, serial.format, language), where["serial"]),
        (term("gap", language), gap, where["timing"]),
        (term("reply", language), reply, where["timing"]),
        (term("lateness", language), f"{timing.max_reply_lateness_s * 1000:g} ms", where["timing"]),
        (term("setpoint", language), _setpoint_step(profile), where["setpoint"]),
        (term("limits", language), limits, where["limits"]),
        (term("writes", language), writes, where["write"]),
        (term("comm_loss", language), lost or term("nothing", language), where["comm_loss"]),
    ]


def _setpoint_step(profile: DriveProfile) -> str:
    share = profile.setpoint_share
    if profile.setpoint_rpm is not None:
        return f"{profile.setpoint_rpm:g} rpm"
    if share is None:
        return f"{profile.setpoint_scale.factor:g} Hz"
    return f"{share.full_scale} = {share.maximum or f'{share.maximum_hz:g} Hz'}"


def _marked(choices: Iterable[object], factory: object, language: str) -> str:
    return i18n.join((f"**{choice}**" if choice == factory else str(choice) for choice in choices), "items", language)


def keypad(profile: DriveProfile, language: str) -> str:
    """Return the keypad steps in order, then the wiring."""
    steps = "\n".join(f"{n}. {localized(step, language)}" for n, step in enumerate(profile.keypad, 1))
    if profile.wiring is None:
        return f"{steps}\n"
    return f"{steps}\n\n{term('wiring', language)}{colon(language)}{localized(profile.wiring, language)}\n"


def signals(profile: DriveProfile, language: str) -> str:
    heads = ("name", "notation", "meaning", "step", "period", "source")
    rows = (
        (
            f"`{s.name}`",
            s.notation,
            localized(s.text, language),
            _step(s, language),
            f"{s.period_s:g} s",
            evidence(s.evidence, language),
        )
        for s in profile.signals.values()
    )
    return table([term(head, language) for head in heads], rows)


def _step(entry: Signal | Parameter, language: str) -> str:
    if entry.uncertain:
        return term("nothing", language)
    return f"{entry.scale.factor:g} {entry.unit}".strip() if entry.unit else "–"


def parameters(profile: DriveProfile, language: str) -> str:
    """Return the parameters, and behind them those whose address the manual does not give."""
    unplaced = [entry.parameter for _, entry in sorted(profile.unplaced.items())]
    heads = ["notation", "meaning", "step", "values", "factory", "source"]
    made = table([term(head, language) for head in heads], _parameter_rows(profile.parameters.values(), language))
    if not unplaced:
        return made
    rows = table([term(head, language) for head in heads], _parameter_rows(unplaced, language))
    return f"{made}\n{term('index_unknown', language)}\n\n{rows}"


def _parameter_rows(shown: Iterable[Parameter], language: str) -> list[tuple[object, ...]]:
    return [
        (
            p.notation,
            localized(p.text, language),
            _step(p, language),
            _values(p, language),
            "–" if p.factory is None else f"{p.factory:g}",
            evidence(p.evidence, language),
        )
        for p in shown
    ]


def _values(parameter: Parameter, language: str) -> str:
    if parameter.choices:
        shown = [f"{raw} = {localized(text, language)}" for raw, text in parameter.choices.items()]
        others = [] if parameter.choices_complete else [term("others", language)]
        return i18n.join([*shown, *others], "clauses", language)
    if parameter.minimum is None or parameter.maximum is None:
        return "–"
    return f"{parameter.minimum:g}–{parameter.maximum:g}"


def commands(profile: DriveProfile, language: str) -> str:
    """Return the bits of the command word, also those of an option, and of the status word."""
    if profile.commands is None:
        return term("nothing", language) + "\n"
    if profile.commands.values:
        return _command_values(profile, language)
    heads = ("command", "meaning", "mask", "value", "acts", "under")
    rows = _bit_rows(profile.commands.bits, "–", language)
    for setting, choices in profile.commands.variants.items():
        for value, bits in choices.items():
            rows += _bit_rows(bits, f"`{setting} = {value}`", language)
    made = f"{_command_place(profile.commands, language)}\n\n" + table([term(head, language) for head in heads], rows)
    return made + _start_words(profile.commands, language) + _status_word(profile, language)


def _command_values(profile: DriveProfile, language: str) -> str:
    """Return the words of a drive whose command word is a number."""
    assert profile.commands is not None
    commands = profile.commands
    rows: list[tuple[object, ...]] = []
    for name, value in commands.values.items():
        rows.append((f"`{name}`", _value_meaning(name, language), _command_value(commands, value)))
    if commands.reset is not None:
        shown = f"{commands.reset.value} ({commands.reset.register:04X}H)"
        rows.append(("`reset`", _value_meaning("reset", language), shown))
    heads = [term(head, language) for head in ("command", "meaning", "value")]
    made = f"{_command_place(commands, language)}\n\n" + table(heads, rows)
    return made + _start_words(commands, language) + _status_word(profile, language)


def _start_words(commands: CommandMap, language: str) -> str:
    """Return the words before a start, the status that a start needs, and the word before a reset."""
    made = ""
    if commands.unlock is not None:
        place, value = f"{commands.unlock.register:04X}H", f"{commands.unlock.value:04X}H"
        made += f"\n{localized(UNLOCK, language).format(place=place, value=value)}\n"
    words = [_word(step.word, commands.values.values()) for step in commands.preparation if step.when is None]
    fixed = i18n.join(words, "items", language)
    if fixed:
        made += f"\n{localized(EVERY_START, language).format(words=fixed)}\n"
    if commands.status_steps:
        heads = [term(head, language) for head in ("before", "value", "after")]
        rows = [
            (_match(step.when, language), _word(step.word, commands.values.values()), _match(step.until, language))
            for step in commands.status_steps
        ]
        made += f"\n{localized(PREPARATION, language)}\n\n" + table(heads, rows)
    if commands.ready is not None:
        made += f"\n{localized(READY, language).format(ready=_match(commands.ready, language))}\n"
    if commands.reset_on_edge:
        made += f"\n{localized(RESET_ON_EDGE, language)}\n"
    return made


def _match(match: WordMatch | None, language: str) -> str:
    if match is None:
        return "–"
    return localized(MATCH, language).format(mask=f"{match.mask:04X}H", value=f"{match.value:04X}H")


def _word(value: int, listed: Iterable[int]) -> str:
    """Return one of the listed words: numbers in decimal, words of bits in hexadecimal, as manuals print them."""
    return str(value) if max(listed) <= LAST_LISTED_NUMBER else f"{value:04X}H"


def _command_value(commands: CommandMap, value: int) -> str:
    """Return a command as it is written: the number of its coil, or its registers."""
    if commands.written_to == "coil":
        return f"{commands.register + value:04X}H"
    if commands.words == 1:
        return _word(value, commands.values.values())
    return " ".join(f"{value >> 16 * place & 0xFFFF:04X}H" for place in reversed(range(commands.words)))


def _command_place(commands: CommandMap, language: str) -> str:
    match commands.written_to:
        case "coils":
            return _coils(commands.register, commands.coil_count, language)
        case "coil":
            return localized(SINGLE_COIL, language)
    last = f"–{commands.register + commands.words - 1:04X}H" if commands.words > 1 else ""
    return f"{commands.register:04X}H{last}"


def _coils(first: int, count: int, language: str) -> str:
    return localized(COILS, language).format(first=f"{first:04X}H", last=f"{first + count - 1:04X}H")


def _status_word(profile: DriveProfile, language: str) -> str:
    status = profile.status
    if status is None:
        return f"\n{term('no_status', language)}\n"
    rows = [(f"`{name}`", localized(BITS[name], language), f"{mask:04X}H") for name, mask in status.bits.items()]
    rows += [
        (f"`{name}`", _value_meaning(name, language), _word(value, status.values))
        for value, name in status.values.items()
    ]
    heads = [term(head, language) for head in ("name", "meaning", "value" if status.values else "mask")]
    if status.space in BIT_SPACES:
        place = _coils(status.register, status.bit_count, language)
    else:
        place = f"{status.register:04X}H"
    made = f"\n{place}\n\n" + table(heads, rows)
    if status.standstill == "output_frequency":
        made += f"\n{localized(STANDSTILL, language)}\n"
    if profile.identity_register is not None:
        made += f"\n{localized(IDENTITY, language).format(register=profile.identity_register)}\n"
    return made


def _value_meaning(name: str, language: str) -> str:
    """Return the words for a value: a state or command, and its direction after a comma."""
    for end in ("_forward", "_reverse"):
        if name.endswith(end) and name not in BITS:
            parts = (BITS[name.removesuffix(end)], BITS[end.removeprefix("_")])
            return i18n.join((localized(part, language) for part in parts), "phrases", language)
    return localized(BITS[name], language)


def _bit_rows(bits: Mapping[str, CommandBit], under: str, language: str) -> list[tuple[object, ...]]:
    return [
        (
            f"`{name}`",
            localized(BITS[name], language),
            f"{bit.mask:04X}H",
            f"{bit.value:04X}H",
            term("pulse" if bit.pulse else "level", language),
            under,
        )
        for name, bit in bits.items()
    ]


def faults(profile: DriveProfile, language: str) -> str:
    """Return the faults; cause and remedy have a column where a listed fault has them."""
    known = list(profile.faults.values())
    advice = [name for name in ("cause", "remedy") if any(getattr(f, name) for f in known)]
    rows: list[tuple[object, ...]] = [
        (
            f.code,
            f.label or "–",
            localized(f.text, language),
            *(localized(text, language) if (text := getattr(f, name)) else "–" for name in advice),
            evidence(f.evidence, language) if f.evidence else "–",
        )
        for f in known
    ]
    if profile.fault_text is not None:
        label = profile.fault_label.replace("{code}", "n") or "–"
        text = localized(profile.fault_text, language).replace("{code}", "n")
        rows.append(("n", label, text, *("–" for _ in advice), "–"))
    return table([term(head, language) for head in ("code", "label", "meaning", *advice, "source")], rows)


def caveats(profile: DriveProfile, language: str) -> str:
    rows = ((_anchored(c.id), localized(c.text, language), evidence(c.evidence, language)) for c in profile.caveats)
    return table([term(head, language) for head in ("id", "meaning", "source")], rows)


def _anchored(id: str) -> str:
    """Return an id with an anchor, so that other pages can link it."""
    return f'<a id="{id.lower()}"></a>**{id}**'


def open_questions(profile: DriveProfile, language: str) -> str:
    heads = ("option", "value_in_force", "question", "reason", "procedure")
    rows = (
        (
            f"`{q.where or q.name}`" if q.where != "-" else "–",
            _assumed_value(q, language),
            localized(q.text, language) + _choices(q, language),
            localized(q.reason, language),
            localized(q.procedure, language),
        )
        for q in profile.open_questions
    )
    return table([term(head, language) for head in heads], rows)


def _assumed_value(question: OpenQuestion, language: str) -> str:
    if isinstance(question.value, Text):
        return localized(question.value, language)
    return f"`{_as_written(question.value)}`"


def _as_written(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _choices(question: OpenQuestion, language: str) -> str:
    choices = [_as_written(choice) for choice in question.choices]
    choices += [f"{question.span[0]}–{question.span[1]}"] if question.span else []
    shown = i18n.join((f"`{choice}`" for choice in choices), "items", language)
    return localized(CHOICES, language).format(choices=shown) if shown else ""
