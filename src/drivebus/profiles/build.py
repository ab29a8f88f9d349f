"""A checked file → the frozen ``DriveProfile``. No judging here: ``schema`` and ``check`` have done that."""

from __future__ import annotations

from typing import Any, cast

from drivebus.profiles import addressing
from drivebus.profiles import model as m
from drivebus.profiles.schema import (
    BilingualTextIn,
    BitIn,
    CommandsIn,
    OptionIn,
    ParameterIn,
    ProfileIn,
    ScaleIn,
    SignalIn,
    StatusIn,
    ValueIn,
)
from drivebus.serial_settings import StationTiming
from drivebus.values import Scale


def build_profile(given: ProfileIn, source: str) -> m.DriveProfile:
    """The profile. ``source`` is the file that it was read from."""
    parameters, unplaced = _build_parameters(given)
    return m.DriveProfile(
        model=given.model,
        maker=_build_text(given.maker),
        title=_build_text(given.title),
        family=given.family,
        grade=given.grade,
        encodings=tuple(given.encodings),
        addresses=(given.addresses[0], given.addresses[1]),
        broadcast=given.broadcast,
        serial=_build_serial(given),
        timing=StationTiming(**given.timing.model_dump(exclude={"evidence"})),
        limits=m.FrequencyLimits(given.limits.minimum_hz, given.limits.maximum_hz),
        capabilities=frozenset(given.capabilities),
        signals=_build_signals(given),
        parameters=parameters,
        preconditions=_build_preconditions(given, unplaced),
        faults={int(code): _build_fault(int(code), fault) for code, fault in given.faults.items()},
        write_support=m.WriteSupport(given.write.ram, given.write.eeprom, given.write.eeprom_address_bit),
        comm_loss=m.CommLossParameters(
            given.comm_loss.time, given.comm_loss.action, tuple(given.comm_loss.trips_values)
        ),
        caveats=tuple(m.Caveat(i, _build_text(c.text), parse_evidence(c.evidence)) for i, c in given.caveats.items()),
        settings=option_values(given),
        setpoint_scale=Scale(given.setpoint.factor, 0.0, given.setpoint.coding, given.setpoint.decimals),
        modbus=_build_modbus(given),
        commands=_build_commands(given.commands),
        status=_build_status(given.status),
        group_sizes=dict(given.group_sizes),
        ramp_notations=(given.ramp[0], given.ramp[1]) if given.ramp else None,
        keypad=tuple(_build_text(step) for step in given.keypad),
        wiring=_build_text(given.wiring) if given.wiring else None,
        source=source,
        format_version=given.format,
        open_questions=_build_options(given),
        notation=m.NotationRule(given.notation.style, given.notation.highest),
        unplaced=unplaced,
        roles=dict(cast("dict[str, str]", given.roles)),
        fault_label=given.unknown_fault.label if given.unknown_fault else "",
        fault_text=_build_text(given.unknown_fault.text) if given.unknown_fault else None,
        evidence=_section_evidence(given),
    )


def option_values(given: ProfileIn) -> dict[str, str | int | float | bool]:
    """The value of every open question that is a setting: the file's, else its default."""
    defaults = {name: question.default for name, question in given.open.items() if question.where is None}
    return {**defaults, **given.settings}


def parse_evidence(line: str) -> m.Evidence:
    """``manual §4.2`` → kind and source."""
    kind, _, source = line.partition(" ")
    return m.Evidence(cast("Any", kind.rstrip(",:")), source)


def _build_text(given: BilingualTextIn) -> m.Text:
    return m.Text(given.en, given.zh)


def _build_scale(given: ScaleIn) -> Scale:
    return Scale(given.factor, given.offset, given.coding, given.decimals)


def _build_serial(given: ProfileIn) -> m.SerialDefaults:
    line = given.line
    return m.SerialDefaults(line.baud, line.format, tuple(line.bauds), tuple(line.formats))


def _build_signals(given: ProfileIn) -> dict[str, m.Signal]:
    """Those whose address is known; an unplaced signal can't be polled and is left to ``unplaced``."""
    placed = {}
    for name, signal in given.signals.items():
        locator = addressing.resolve_locator(given, signal.notation, signal.register_)
        if isinstance(locator, tuple):
            placed[name] = _build_signal(name, signal, locator)
    return placed


def _build_signal(name: str, given: SignalIn, locator: m.Locator) -> m.Signal:
    return m.Signal(
        name,
        given.notation,
        locator,
        _build_text(given.text),
        given.unit,
        _build_scale(given),
        given.period_s,
        given.minimum,
        given.maximum,
        parse_evidence(given.evidence),
        _uncertain_reason(given),
    )


def _build_parameters(given: ProfileIn) -> tuple[dict[str, m.Parameter], dict[str, m.Text]]:
    """Parameters with an address, and why the others have none."""
    placed: dict[str, m.Parameter] = {}
    unplaced: dict[str, m.Text] = {}
    for notation, parameter in given.parameters.items():
        locator = addressing.resolve_locator(given, notation, parameter.register_)
        if isinstance(locator, tuple):
            chosen = option_values(given).get(parameter.maximum_setting or "")
            maximum = float(chosen) if isinstance(chosen, int) else parameter.maximum
            placed[notation] = _build_parameter(notation, parameter, locator, maximum)
        elif isinstance(locator, Exception):
            unplaced[notation] = m.Text(locator.text("en"), locator.text("zh"))
    return placed, unplaced


def _build_parameter(notation: str, given: ParameterIn, locator: m.Locator, maximum: float | None) -> m.Parameter:
    return m.Parameter(
        notation,
        locator,
        _build_text(given.text),
        given.unit,
        _build_scale(given),
        given.minimum,
        maximum,
        given.writable,
        {int(raw): _build_text(choice) for raw, choice in given.choices.items()},
        _build_text(given.help) if given.help else None,
        given.caveat,
        given.factory,
        parse_evidence(given.evidence),
        given.readable,
        uncertain=_uncertain_reason(given),
    )


def _uncertain_reason(given: ValueIn) -> str | None:
    return None if given.scale_published else "profiles.scale_unpublished"


def _build_preconditions(given: ProfileIn, unplaced: dict[str, m.Text]) -> tuple[m.Precondition, ...]:
    return tuple(
        m.Precondition(notation, tuple(wanted.accepted), _build_text(wanted.keypad), unplaced.get(notation))
        for notation, wanted in given.preconditions.items()
    )


def _build_fault(code: int, given: Any) -> m.FaultEntry:
    cause, remedy = (_build_text(text) if text else None for text in (given.cause, given.remedy))
    return m.FaultEntry(code, given.label, _build_text(given.text), cause, remedy)


def _build_modbus(given: ProfileIn) -> m.ModbusFeatures | None:
    rule = given.modbus
    return m.ModbusFeatures(tuple(rule.functions), rule.max_read, rule.error_form, rule.loopback) if rule else None


def _build_bit(given: BitIn) -> m.CommandBit:
    return m.CommandBit(given.mask, given.value, given.pulse)


def _build_commands(given: CommandsIn | None) -> m.CommandMap | None:
    if given is None:
        return None
    variants = {
        setting: {value: {name: _build_bit(bit) for name, bit in bits.items()} for value, bits in choices.items()}
        for setting, choices in given.variants.items()
    }
    return m.CommandMap(
        given.register_,
        {name: _build_bit(bit) for name, bit in given.bits.items()},
        given.setpoint_register,
        given.rewrite_levels_after_pulse,
        given.function,
        cast("Any", variants),
    )


def _build_status(given: StatusIn | None) -> m.StatusMap | None:
    if given is None:
        return None
    bits = cast("dict[str, int]", dict(given.bits))
    return m.StatusMap(given.register_, bits, given.reserved_mask, tuple(given.fault_registers))


def _build_span(given: OptionIn) -> tuple[int, int] | None:
    return (given.span[0], given.span[1]) if given.span else None


def _build_options(given: ProfileIn) -> tuple[m.OpenQuestion, ...]:
    return tuple(
        m.OpenQuestion(
            name,
            q.default,
            tuple(q.choices),
            _build_text(q.text),
            _build_text(q.reason),
            _build_text(q.settle),
            q.where,
            _build_span(q),
        )
        for name, q in given.open.items()
    )


def _section_evidence(given: ProfileIn) -> dict[str, m.Evidence]:
    names = ("line", "timing", "limits", "setpoint", "write", "comm_loss", "commands", "status", "modbus")
    sections = {name: getattr(given, name) for name in names}
    return {name: parse_evidence(section.evidence) for name, section in sections.items() if section is not None}
