"""A checked file → the frozen ``DriveProfile``. No judging here: ``schema`` and ``check`` have done that."""

from __future__ import annotations

from typing import Any, cast

from drivebus.message import StationTiming
from drivebus.profiles import model as m
from drivebus.profiles import places
from drivebus.profiles.schema import (
    BitIn,
    CommandsIn,
    OpenIn,
    ParameterIn,
    ProfileIn,
    ScaleIn,
    SignalIn,
    StatusIn,
    TextIn,
    ValueIn,
)
from drivebus.units import Scale


def profile(given: ProfileIn, source: str) -> m.DriveProfile:
    """The profile. ``source`` is the file that it was read from."""
    parameters, unplaced = _parameters(given)
    return m.DriveProfile(
        model=given.model,
        maker=_text(given.maker),
        title=_text(given.title),
        family=given.family,
        grade=given.grade,
        encodings=tuple(given.encodings),
        addresses=(given.addresses[0], given.addresses[1]),
        broadcast=given.broadcast,
        line=_line(given),
        timing=StationTiming(**given.timing.model_dump(exclude={"evidence"})),
        limits=m.Limits(given.limits.minimum_hz, given.limits.maximum_hz),
        capabilities=frozenset(given.capabilities),
        signals=_signals(given),
        parameters=parameters,
        preconditions=_preconditions(given, unplaced),
        faults={int(code): _fault(int(code), fault) for code, fault in given.faults.items()},
        write_rule=m.WriteRule(given.write.ram, given.write.eeprom, given.write.eeprom_address_bit),
        comm_loss=m.CommLoss(given.comm_loss.time, given.comm_loss.action, tuple(given.comm_loss.trips_values)),
        caveats=tuple(m.Caveat(i, _text(c.text), evidence(c.evidence)) for i, c in given.caveats.items()),
        settings=settings(given),
        setpoint_scale=Scale(given.setpoint.factor, 0.0, given.setpoint.coding, given.setpoint.decimals),
        modbus=_modbus(given),
        commands=_commands(given.commands),
        status=_status(given.status),
        group_sizes=dict(given.group_sizes),
        ramp_notations=(given.ramp[0], given.ramp[1]) if given.ramp else None,
        keypad=tuple(_text(step) for step in given.keypad),
        wiring=_text(given.wiring) if given.wiring else None,
        source=source,
        format_version=given.format,
        open_questions=_open(given),
        notation=m.NotationRule(given.notation.style, given.notation.highest),
        unplaced=unplaced,
        roles=dict(cast("dict[str, str]", given.roles)),
        fault_label=given.unknown_fault.label if given.unknown_fault else "",
        fault_text=_text(given.unknown_fault.text) if given.unknown_fault else None,
        evidence=_sections(given),
    )


def settings(given: ProfileIn) -> dict[str, str | int | float | bool]:
    """The value of every open question that is a setting: the file's, else its default."""
    defaults = {name: question.default for name, question in given.open.items() if question.where is None}
    return {**defaults, **given.settings}


def evidence(line: str) -> m.Evidence:
    """``manual §4.2`` → kind and source."""
    kind, _, source = line.partition(" ")
    return m.Evidence(cast("Any", kind.rstrip(",:")), source)


def _text(given: TextIn) -> m.Text:
    return m.Text(given.en, given.zh)


def _scale(given: ScaleIn) -> Scale:
    return Scale(given.factor, given.offset, given.coding, given.decimals)


def _line(given: ProfileIn) -> m.LineDefaults:
    line = given.line
    return m.LineDefaults(line.baud, line.format, tuple(line.bauds), tuple(line.formats))


def _signals(given: ProfileIn) -> dict[str, m.Signal]:
    """Those whose address is known; an unplaced signal can't be polled and is left to ``unplaced``."""
    placed = {}
    for name, signal in given.signals.items():
        locator = places.place(given, signal.notation, signal.register_)
        if isinstance(locator, tuple):
            placed[name] = _signal(name, signal, locator)
    return placed


def _signal(name: str, given: SignalIn, locator: m.Locator) -> m.Signal:
    return m.Signal(
        name,
        given.notation,
        locator,
        _text(given.text),
        given.unit,
        _scale(given),
        given.period_s,
        given.minimum,
        given.maximum,
        evidence(given.evidence),
        _uncertain(given),
    )


def _parameters(given: ProfileIn) -> tuple[dict[str, m.Parameter], dict[str, m.Text]]:
    """Parameters with an address, and why the others have none."""
    placed: dict[str, m.Parameter] = {}
    unplaced: dict[str, m.Text] = {}
    for notation, parameter in given.parameters.items():
        locator = places.place(given, notation, parameter.register_)
        if isinstance(locator, tuple):
            chosen = settings(given).get(parameter.maximum_setting or "")
            maximum = float(chosen) if isinstance(chosen, int) else parameter.maximum
            placed[notation] = _parameter(notation, parameter, locator, maximum)
        elif isinstance(locator, Exception):
            unplaced[notation] = m.Text(locator.text("en"), locator.text("zh"))
    return placed, unplaced


def _parameter(notation: str, given: ParameterIn, locator: m.Locator, maximum: float | None) -> m.Parameter:
    return m.Parameter(
        notation,
        locator,
        _text(given.text),
        given.unit,
        _scale(given),
        given.minimum,
        maximum,
        given.writable,
        {int(raw): _text(choice) for raw, choice in given.choices.items()},
        _text(given.help) if given.help else None,
        given.caveat,
        given.factory,
        evidence(given.evidence),
        given.readable,
        uncertain=_uncertain(given),
    )


def _uncertain(given: ValueIn) -> str | None:
    return None if given.scale_published else "profiles.scale_unpublished"


def _preconditions(given: ProfileIn, unplaced: dict[str, m.Text]) -> tuple[m.Precondition, ...]:
    return tuple(
        m.Precondition(notation, tuple(wanted.accepted), _text(wanted.keypad), unplaced.get(notation))
        for notation, wanted in given.preconditions.items()
    )


def _fault(code: int, given: Any) -> m.FaultEntry:
    cause, remedy = (_text(text) if text else None for text in (given.cause, given.remedy))
    return m.FaultEntry(code, given.label, _text(given.text), cause, remedy)


def _modbus(given: ProfileIn) -> m.ModbusRule | None:
    rule = given.modbus
    return m.ModbusRule(tuple(rule.functions), rule.max_read, rule.error_form, rule.loopback) if rule else None


def _bit(given: BitIn) -> m.CommandBit:
    return m.CommandBit(given.mask, given.value, given.pulse)


def _commands(given: CommandsIn | None) -> m.CommandMap | None:
    if given is None:
        return None
    variants = {
        setting: {value: {name: _bit(bit) for name, bit in bits.items()} for value, bits in choices.items()}
        for setting, choices in given.variants.items()
    }
    return m.CommandMap(
        given.register_,
        {name: _bit(bit) for name, bit in given.bits.items()},
        given.setpoint_register,
        given.rewrite_levels_after_pulse,
        given.function,
        cast("Any", variants),
    )


def _status(given: StatusIn | None) -> m.StatusMap | None:
    if given is None:
        return None
    bits = cast("dict[str, int]", dict(given.bits))
    return m.StatusMap(given.register_, bits, given.reserved_mask, tuple(given.fault_registers))


def _span(given: OpenIn) -> tuple[int, int] | None:
    return (given.span[0], given.span[1]) if given.span else None


def _open(given: ProfileIn) -> tuple[m.OpenQuestion, ...]:
    return tuple(
        m.OpenQuestion(
            name, q.default, tuple(q.choices), _text(q.text), _text(q.reason), _text(q.settle), q.where, _span(q)
        )
        for name, q in given.open.items()
    )


def _sections(given: ProfileIn) -> dict[str, m.Evidence]:
    names = ("line", "timing", "limits", "setpoint", "write", "comm_loss", "commands", "status", "modbus")
    sections = {name: getattr(given, name) for name in names}
    return {name: evidence(section.evidence) for name, section in sections.items() if section is not None}
