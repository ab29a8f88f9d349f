"""Builder of the ``DriveProfile`` from the checked tables of a file."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any, cast

from drivebus.profiles import model as m
from drivebus.profiles import words
from drivebus.profiles.check import resolve_locator
from drivebus.profiles.evidence import parse_evidence
from drivebus.profiles.schema import (
    BitTable,
    CommandsTable,
    FaultTable,
    IdentityTable,
    OptionTable,
    ParameterTable,
    ProfileFile,
    ScaleTable,
    SetpointTable,
    SignalTable,
    StatusTable,
    ValueTable,
    WordMatchTable,
)
from drivebus.protocols.family import Locator, protocol_family
from drivebus.serial_settings import StationTiming
from drivebus.values import Scale, Text, bilingual_text


def build_profile(parsed: ProfileFile, source: str) -> m.DriveProfile:
    """Build the profile of a checked file; ``source`` is the path of the file."""
    parameters, unplaced = _build_parameters(parsed)
    return m.DriveProfile(
        model=parsed.model,
        maker=Text.from_mapping(parsed.maker),
        title=Text.from_mapping(parsed.title),
        family=parsed.family,
        grade=parsed.grade,
        encodings=tuple(parsed.encodings),
        addresses=(parsed.addresses[0], parsed.addresses[1]),
        broadcast=parsed.broadcast,
        serial=_build_serial(parsed),
        timing=StationTiming(**parsed.timing.model_dump(exclude={"evidence"})),
        limits=m.FrequencyLimits(parsed.limits.minimum_hz, parsed.limits.maximum_hz),
        capabilities=frozenset(parsed.capabilities),
        signals=_build_signals(parsed),
        parameters=parameters,
        preconditions=_build_preconditions(parsed, unplaced),
        faults={int(code): _build_fault(int(code), fault) for code, fault in parsed.faults.items()},
        write_support=m.WriteSupport(**parsed.write.model_dump(exclude={"evidence"})),
        comm_loss=m.CommLossParameters(
            parsed.comm_loss.time, parsed.comm_loss.action, tuple(parsed.comm_loss.trips_values)
        ),
        caveats=tuple(
            m.Caveat(i, Text.from_mapping(c.text), parse_evidence(c.evidence)) for i, c in parsed.caveats.items()
        ),
        options=option_values(parsed),
        setpoint_scale=_build_setpoint_scale(parsed.setpoint),
        setpoint_share=_build_setpoint_share(parsed),
        setpoint_rpm=parsed.setpoint.rpm,
        modbus=_build_modbus(parsed),
        commands=_build_commands(parsed.commands),
        status=_build_status(parsed.status),
        identity_register=parsed.identity.register_ if parsed.identity else None,
        identity_codes=_build_identity_codes(parsed.identity),
        group_sizes=dict(parsed.group_sizes),
        ramp_notations=(parsed.ramp[0], parsed.ramp[1]) if parsed.ramp else None,
        keypad=tuple(Text.from_mapping(step) for step in parsed.keypad),
        wiring=Text.from_mapping(parsed.wiring) if parsed.wiring else None,
        source=source,
        open_questions=_build_open_questions(parsed),
        notation=m.NotationRule(parsed.family, parsed.notation.style, parsed.notation.highest),
        unplaced=unplaced,
        roles=dict(cast("dict[str, str]", parsed.roles)),
        fault_label=parsed.unknown_fault.label if parsed.unknown_fault else "",
        fault_text=Text.from_mapping(parsed.unknown_fault.text) if parsed.unknown_fault else None,
        evidence=_section_evidence(parsed),
    )


def option_values(parsed: ProfileFile) -> dict[str, str | int | float | bool]:
    """Return the value of every option."""
    shared: dict[str, str | int | float | bool] = {m.MAXIMUM_FREQUENCY: 0} if parsed.setpoint.full_scale else {}
    shared |= {m.POLE_PAIRS: 0} if parsed.setpoint.rpm else {}
    shared |= {m.SETPOINT_STEP: m.UNDETERMINED} if _has_assumed_step(parsed) else {}
    return shared | {name: option.value for name, option in parsed.options.items()}


def _has_assumed_step(parsed: ProfileFile) -> bool:
    """Return whether nothing proves the step of the setpoint and no option of the file or its family asks for it."""
    has_option = m.SETPOINT_STEP in parsed.options or protocol_family(parsed.family).scale_option is not None
    return parsed.setpoint.is_assumed and not has_option


def _build_scale(parsed: ScaleTable) -> Scale:
    return Scale(parsed.factor, parsed.offset, parsed.coding, parsed.decimals, parsed.words)


def _build_setpoint_scale(parsed: SetpointTable) -> Scale:
    step_hz = parsed.highest_hz / parsed.full_scale if parsed.full_scale and parsed.highest_hz else parsed.factor
    return Scale(step_hz, 0.0, parsed.coding, parsed.decimals, parsed.words)


def _build_setpoint_share(parsed: ProfileFile) -> m.SetpointShare | None:
    setpoint = parsed.setpoint
    if setpoint.full_scale is None or setpoint.highest_hz is None:
        return None
    parameter = parsed.parameters.get(setpoint.maximum or "")
    lowest_hz = setpoint.lowest_hz or (parameter.minimum if parameter else None) or (setpoint.maximum_hz or 0.0) / 2
    return m.SetpointShare(setpoint.full_scale, setpoint.maximum, setpoint.maximum_hz, lowest_hz, setpoint.highest_hz)


def _build_serial(parsed: ProfileFile) -> m.SerialDefaults:
    serial = parsed.serial
    return m.SerialDefaults(serial.baud, serial.format, tuple(serial.bauds), tuple(serial.formats))


def _build_signals(parsed: ProfileFile) -> dict[str, m.Signal]:
    """Build the signals whose address is known; others can't be polled."""
    signals = {}
    for name, signal in parsed.signals.items():
        locator = resolve_locator(parsed, signal.notation, signal)
        if isinstance(locator, tuple):
            signals[name] = _build_signal(name, signal, locator)
    return signals


def _build_signal(name: str, parsed: SignalTable, locator: Locator) -> m.Signal:
    return m.Signal(
        name=name,
        notation=parsed.notation,
        locator=locator,
        text=Text.from_mapping(parsed.text),
        unit=parsed.unit,
        scale=_build_scale(parsed),
        period_s=parsed.period_s,
        minimum=parsed.minimum,
        maximum=parsed.maximum,
        evidence=parse_evidence(parsed.evidence),
        uncertain=_uncertain_reason(parsed),
    )


def _build_parameters(parsed: ProfileFile) -> tuple[dict[str, m.Parameter], dict[str, m.UnplacedParameter]]:
    """Build the parameters with an address, and the reason for each that has none."""
    parameters: dict[str, m.Parameter] = {}
    unplaced: dict[str, m.UnplacedParameter] = {}
    for notation, parameter in parsed.parameters.items():
        locator = resolve_locator(parsed, notation, parameter)
        if isinstance(locator, tuple):
            option_value = option_values(parsed).get(parameter.maximum_option or "")
            maximum = float(option_value) if isinstance(option_value, int) else parameter.maximum
            parameters[notation] = _build_parameter(notation, parameter, locator, maximum)
        elif isinstance(locator, Exception):
            described = _build_parameter(notation, parameter, ("unplaced", 0), parameter.maximum)
            unplaced[notation] = m.UnplacedParameter(described, Text.per_language(locator.text))
    return parameters, unplaced


def _build_parameter(notation: str, parsed: ParameterTable, locator: Locator, maximum: float | None) -> m.Parameter:
    return m.Parameter(
        notation=notation,
        locator=locator,
        text=Text.from_mapping(parsed.text),
        unit=parsed.unit,
        scale=_build_scale(parsed),
        minimum=parsed.minimum,
        maximum=maximum,
        writable=parsed.writable,
        choices={int(raw): Text.from_mapping(choice) for raw, choice in parsed.choices.items()},
        choices_complete=parsed.choices_complete,
        help=Text.from_mapping(parsed.help) if parsed.help else None,
        caveat=parsed.caveat,
        factory=parsed.factory,
        evidence=parse_evidence(parsed.evidence),
        readable=parsed.readable,
        uncertain=_uncertain_reason(parsed),
    )


def _uncertain_reason(parsed: ValueTable) -> str | None:
    return None if parsed.scale_published else "profiles.scale_unpublished"


def _build_preconditions(
    parsed: ProfileFile, unplaced: Mapping[str, m.UnplacedParameter]
) -> tuple[m.Precondition, ...]:
    reasons = {notation: parameter.reason for notation, parameter in unplaced.items()}
    return tuple(
        m.Precondition(
            notation, tuple(precondition.accepted), Text.from_mapping(precondition.keypad), reasons.get(notation)
        )
        for notation, precondition in parsed.preconditions.items()
    )


def _build_fault(code: int, parsed: FaultTable) -> m.FaultEntry:
    cause, remedy = (Text.from_mapping(text) if text else None for text in (parsed.cause, parsed.remedy))
    return m.FaultEntry(
        code=code,
        label=parsed.label,
        text=Text.from_mapping(parsed.text),
        cause=cause,
        remedy=remedy,
        evidence=parse_evidence(parsed.evidence),
    )


def _build_modbus(parsed: ProfileFile) -> m.ModbusFeatures | None:
    modbus = parsed.modbus
    if modbus is None:
        return None
    return m.ModbusFeatures(
        functions=tuple(modbus.functions),
        max_read=modbus.max_read,
        error_form=modbus.error_form,
        loopback=modbus.loopback,
        word_order=modbus.word_order,
        blocks=tuple((first, count) for first, count in modbus.blocks),
        reply_count_bytes=modbus.reply_count_bytes,
        rejected_read=modbus.rejected_read,
        sync_block=(modbus.sync_block[0], modbus.sync_block[1]) if modbus.sync_block else None,
    )


def _build_bit(parsed: BitTable) -> words.CommandBit:
    return words.CommandBit(parsed.mask, parsed.value, parsed.pulse)


def _build_match(parsed: WordMatchTable) -> words.WordMatch:
    return words.WordMatch(parsed.mask, parsed.value)


def _build_commands(parsed: CommandsTable | None) -> words.CommandMap | None:
    if parsed is None:
        return None
    variants = {
        setting: {value: {name: _build_bit(bit) for name, bit in bits.items()} for value, bits in choices.items()}
        for setting, choices in parsed.variants.items()
    }
    return words.CommandMap(
        register=parsed.register_,
        bits={name: _build_bit(bit) for name, bit in parsed.bits.items()},
        setpoint_register=parsed.setpoint_register,
        rewrite_levels_after_pulse=parsed.rewrite_levels_after_pulse,
        values=cast("dict[str, int]", dict(parsed.values)),
        variants=cast("Any", variants),
        words=parsed.words,
        written_to=parsed.written_to,
        coil_count=parsed.coil_count,
        reset=words.FixedWrite(parsed.reset.register_, parsed.reset.value) if parsed.reset else None,
        unlock=words.FixedWrite(parsed.unlock.register_, parsed.unlock.value) if parsed.unlock else None,
        preparation=tuple(
            words.StartStep(
                when=_build_match(step.when) if step.when else None,
                word=step.word,
                until=_build_match(step.until) if step.until else None,
                timeout_s=step.timeout_s,
            )
            for step in parsed.preparation
        ),
        ready=_build_match(parsed.ready) if parsed.ready else None,
        reset_on_edge=parsed.reset_on_edge,
    )


def _build_status(parsed: StatusTable | None) -> words.StatusMap | None:
    if parsed is None:
        return None
    return words.StatusMap(
        register=parsed.register_,
        bits=cast("dict[str, int]", dict(parsed.bits)),
        reserved_mask=parsed.reserved_mask,
        fault_registers=tuple(parsed.fault_registers),
        values={int(value): name for value, name in parsed.values.items()},
        mask=parsed.mask,
        numbers_fault=parsed.fault_coding == "number",
        fault_mask=parsed.fault_mask,
        standstill=parsed.standstill,
        space=parsed.space,
    )


def _build_identity_codes(parsed: IdentityTable | None) -> m.IdentityCodes | None:
    if parsed is None or parsed.code_register is None:
        return None
    return m.IdentityCodes(parsed.code_register, {int(code, 16): tuple(names) for code, names in parsed.codes.items()})


def _build_span(parsed: OptionTable) -> tuple[int, int] | None:
    return (parsed.span[0], parsed.span[1]) if parsed.span else None


def _build_open_questions(parsed: ProfileFile) -> tuple[m.OpenQuestion, ...]:
    options = (
        m.OpenQuestion(
            name=name,
            value=option.value,
            choices=tuple(option.choices),
            text=Text.from_mapping(option.text),
            reason=Text.from_mapping(option.reason),
            procedure=Text.from_mapping(option.procedure),
            span=_build_span(option),
        )
        for name, option in parsed.options.items()
        if option.text and option.reason and option.procedure
    )
    others = (
        m.OpenQuestion(
            name=name,
            value=Text.from_mapping(question.assumed) if isinstance(question.assumed, dict) else question.assumed,
            choices=(),
            text=Text.from_mapping(question.text),
            reason=Text.from_mapping(question.reason),
            procedure=Text.from_mapping(question.procedure),
            where=question.where,
        )
        for name, question in parsed.open_questions.items()
        if name not in option_values(parsed)
    )
    return (*options, *others, *_setpoint_questions(parsed))


def _setpoint_questions(parsed: ProfileFile) -> list[m.OpenQuestion]:
    """Return the questions for what the meaning of a setpoint word depends on."""
    share, parts = _build_setpoint_share(parsed), ("text", "reason", "procedure")
    questions: list[m.OpenQuestion] = []
    if share is not None:
        texts = [bilingual_text(f"profiles.maximum_frequency_{part}") for part in parts]
        span = (ceil(share.lowest_hz), int(share.highest_hz))
        questions.append(_setpoint_question(m.MAXIMUM_FREQUENCY, span, *texts))
    if parsed.setpoint.rpm is not None:
        texts = [bilingual_text(f"profiles.pole_pairs_{part}") for part in parts]
        questions.append(_setpoint_question(m.POLE_PAIRS, (1, m.MAX_POLE_PAIRS), *texts))
    if _has_assumed_step(parsed):
        steps = [f"{step:g}" for step in m.USUAL_STEPS_HZ]
        params = {"step_hz": f"{parsed.setpoint.factor:g}", "steps_hz": tuple(steps)}
        text, reason, procedure = (bilingual_text(f"profiles.setpoint_step_{part}", **params) for part in parts)
        questions.append(
            m.OpenQuestion(
                name=m.SETPOINT_STEP,
                value=m.UNDETERMINED,
                choices=(m.UNDETERMINED, *steps),
                text=text,
                reason=reason,
                procedure=procedure,
            )
        )
    return questions


def _setpoint_question(name: str, span: tuple[int, int], text: Text, reason: Text, procedure: Text) -> m.OpenQuestion:
    return m.OpenQuestion(name=name, value=0, choices=(0,), text=text, reason=reason, procedure=procedure, span=span)


def _section_evidence(parsed: ProfileFile) -> dict[str, m.Evidence]:
    names = ("serial", "timing", "limits", "setpoint", "write", "comm_loss", "commands", "status", "modbus", "identity")
    sections = {name: getattr(parsed, name) for name in names}
    return {name: parse_evidence(section.evidence) for name, section in sections.items() if section is not None}
