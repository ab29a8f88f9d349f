"""Loader of profiles: finds the TOML file, follows ``extends``, checks it and builds the ``DriveProfile``.

A model name is searched among the profiles that come with drivebus, those of installed protocol families, and the
user's directory (``$XDG_CONFIG_HOME/drivebus/profiles``), in this order. A user's profile can't take the name of one of
the others, so that no ``vc660`` changes silently.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from drivebus.errors import ProfileError
from drivebus.profiles import model as m
from drivebus.profiles.check import check_profile, resolve_locator
from drivebus.profiles.diagnostics import (
    Diagnostic,
    Issue,
    bilingual_text,
    control_character_issues,
    issue,
    issues_from_pydantic,
    nearest_names,
    profile_error,
    to_diagnostic,
)
from drivebus.profiles.schema import (
    NEWEST_FORMAT,
    BitIn,
    CommandsIn,
    IdentityIn,
    OptionIn,
    ParameterIn,
    ProfileIn,
    ScaleIn,
    SetpointIn,
    SignalIn,
    StatusIn,
    ValueIn,
    WordMatchIn,
)
from drivebus.profiles.toml_file import MAX_TOML_BYTES, TomlFault, decode_toml, format_issue, has_key, line_of
from drivebus.protocols.family import Locator, protocol_families, protocol_family
from drivebus.serial_settings import StationTiming
from drivebus.values import Scale, Text

DATA_DIRECTORY = Path(__file__).parent / "data"


@dataclass(frozen=True, slots=True)
class _TomlSource:
    """File of an ``extends`` chain."""

    path: Path
    text: str
    data: Mapping[str, Any]


def models() -> list[str]:
    """Return the names that ``load`` accepts: built-in models, those of other families, then the user's."""
    own: list[str] = []
    with suppress(ProfileError):  # the directory may be unreadable
        own = sorted(_user_files())
    return [*included_models(), *own]


def included_models() -> list[str]:
    """Return the built-in models and those of other families, without the user's."""
    return [*_builtin_files(), *_family_files()]


def load(model: str | Path) -> m.DriveProfile:
    """Return the profile of a model by name, or of a TOML file by path.

    Raises ProfileError; its params carry file, line, key, found, expected, remedy and every fault as ``complaints``.
    """
    path = _find_file(model)
    return _builtin_profile(path) if path.is_relative_to(DATA_DIRECTORY) else _load_profile(path)


def profile_files(model: str | Path) -> list[Path]:
    """Return the file of a profile and, in this order, those that it extends. Raises ProfileError."""
    return [source.path for source in _read_chain(_find_file(model))]


def own_files(model: str | Path) -> list[Path]:
    """Return those files of a profile that are not installed with a family. Raises ProfileError."""
    installed = (DATA_DIRECTORY, *(family.profiles for family in protocol_families() if family.profiles is not None))
    found = profile_files(model)
    return [path for path in found if not any(path.is_relative_to(folder) for folder in installed)]


@cache
def _builtin_profile(path: Path) -> m.DriveProfile:
    """Load a built-in profile once per process; a user's file may change and is read again."""
    return _load_profile(path)


def _load_profile(path: Path) -> m.DriveProfile:
    sources = _read_chain(path)
    merged = _merge_chain(sources)
    try:
        profile_in = ProfileIn.model_validate(merged)
    except ValidationError as error:
        raise _located_error(sources, issues_from_pydantic(error, ProfileIn)) from None
    issues = list(check_profile(profile_in))
    if issues:
        raise _located_error(sources, issues)
    return build_profile(profile_in, str(path))


@cache
def _builtin_files() -> dict[str, Path]:
    """Return the built-in models; a file whose name begins with ``_`` is only a base of others."""
    makers = [_toml_files(folder) for folder in sorted(_list_directory(DATA_DIRECTORY)) if folder.is_dir()]
    return {path.stem: path for files in makers for path in files if not path.name.startswith("_")}


def _family_files() -> dict[str, Path]:
    folders = [family.profiles for family in protocol_families() if family.profiles is not None]
    return {path.stem: path for folder in folders for path in _toml_files(folder) if not path.name.startswith("_")}


def user_directory() -> Path:
    """Return the directory of the user's profiles."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "drivebus" / "profiles"


def _user_files() -> dict[str, Path]:
    return {path.stem: path for path in _toml_files(user_directory())}


def _toml_files(folder: Path) -> list[Path]:
    return sorted(path for path in _list_directory(folder) if path.suffix == ".toml")


def _list_directory(folder: Path) -> list[Path]:
    """Return the entries of a folder; none where it does not exist. Raises ProfileError where it can't be read."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _single_error(folder, issue("unreadable", (), error.strerror or str(error))) from None


def _find_file(model: str | Path, beside: Path | None = None) -> Path:
    """Return the file of a model name or path. Raises ProfileError where there is none, or two of one name."""
    name = str(model)
    if isinstance(model, Path) or name.endswith(".toml") or "/" in name or os.sep in name:
        path = (beside or Path()) / Path(name).expanduser()
        if not path.is_file():
            raise _single_error(path, issue("no_file", (), name))
        return path.resolve()
    shipped, own = _builtin_files().get(name) or _family_files().get(name), None
    with suppress(ProfileError) if shipped else nullcontext():
        own = _user_files().get(name)
    if shipped and own:
        raise _single_error(own, issue("shadows", (), name))
    found = shipped or own
    if found is None:
        raise _single_error(Path(name), issue("no_model", (), name, near=", ".join(similar_models(name)) or "-"))
    return found


def similar_models(name: str) -> list[str]:
    """Return the models whose names are nearest to a name."""
    return nearest_names(name, models())


def _single_error(path: Path, found: Issue, line: int | None = None) -> ProfileError:
    return profile_error([to_diagnostic(found, str(path), line)])


def _read_chain(path: Path) -> list[_TomlSource]:
    """Read a file and all that it extends, in this order. Raises ProfileError for a circle or a missing base."""
    sources = [_read_source(path)]
    while (base := sources[-1].data.get("extends")) is not None:
        here = sources[-1]
        if not isinstance(base, str):
            raise _located_error(
                [here], [issue("type", ("extends",), base, type=bilingual_text("profiles.type.string"))]
            )
        base_path = _base_path(here, base)
        if any(source.path == base_path for source in sources):
            circle = " -> ".join(source.path.name for source in sources) + f" -> {base_path.name}"
            raise _located_error([here], [issue("circle", ("extends",), base, circle=circle)])
        sources.append(_read_source(base_path))
    return sources


def _base_path(here: _TomlSource, base: str) -> Path:
    try:
        return _find_file(base, here.path.parent)
    except ProfileError as error:
        if error.params["file"] == str(here.path):
            raise
        near = ", ".join(similar_models(base)) or "-"
        raise _located_error([here], [issue("no_base", ("extends",), base, near=near)]) from None


def _read_source(path: Path) -> _TomlSource:
    """Read one file; only size, encoding, syntax and format are checked."""
    try:
        text, data = decode_toml(_read_bytes(path))
    except TomlFault as fault:
        raise _single_error(path, fault.issue, fault.line) from None
    source = _TomlSource(path, text, data)
    wrong_format = format_issue(data, NEWEST_FORMAT)
    if wrong_format is not None:
        raise _located_error([source], [wrong_format])
    unprintable = list(control_character_issues(data))
    if unprintable:
        raise _located_error([source], unprintable)
    return source


def _read_bytes(path: Path) -> bytes:
    """Read a file; one of size 0 is not opened, because a remote caller may name an endless file of /proc."""
    try:
        size = path.stat().st_size
        if size > MAX_TOML_BYTES:
            raise _single_error(path, issue("too_large", (), size, most=MAX_TOML_BYTES), 1)
        with path.open("rb") as file:
            return file.read(MAX_TOML_BYTES) if size else b""
    except OSError as error:
        raise _single_error(path, issue("unreadable", (), error.strerror or str(error))) from None


def _merge_chain(sources: list[_TomlSource]) -> dict[str, Any]:
    """Merge a chain, the last base first, without the key ``extends``."""
    result: dict[str, Any] = {}
    for source in reversed(sources):
        data = {key: value for key, value in source.data.items() if key != "extends"}
        result = _merge(
            result, data | {name: _inherit_scale(data[name]) for name in ("signals", "parameters") if name in data}
        )
    return result


def _inherit_scale(table: Any) -> Any:
    """Mark the scale of each entry with a ``factor`` as published, unless it says otherwise itself."""
    if not isinstance(table, Mapping):
        return table
    return {
        name: {"scale_published": True, **entry} if isinstance(entry, Mapping) and "factor" in entry else entry
        for name, entry in table.items()
    }


def _merge(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Merge tables key by key; other values, lists too, are replaced."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(value, Mapping) and isinstance(below, Mapping) else value
    return merged


def _located_error(sources: list[_TomlSource], issues: list[Issue]) -> ProfileError:
    """Return the error with each issue at the line of its key, in the nearest file that has it."""
    located = sorted((_locate_issue(sources, found) for found in issues), key=lambda c: (c.file, c.line or 0))
    return profile_error(located)


def _locate_issue(sources: list[_TomlSource], found: Issue) -> Diagnostic:
    for source in sources:
        for path in (found.path, *found.related):
            if has_key(source.text, path):
                return _diagnostic_in(source, replace(found, path=path))
    return _diagnostic_in(max(sources, key=lambda source: _matching_depth(source, found)), found)


def _diagnostic_in(source: _TomlSource, found: Issue) -> Diagnostic:
    return to_diagnostic(found, str(source.path), line_of(source.text, found.path) or 1)


def _matching_depth(source: _TomlSource, found: Issue) -> int:
    """Return how many parts of the key path are in this file."""
    return max((n for n in range(len(found.path) + 1) if has_key(source.text, found.path[:n])), default=0)


def build_profile(parsed: ProfileIn, source: str) -> m.DriveProfile:
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
        format_version=parsed.format,
        open_questions=_build_open_questions(parsed),
        notation=m.NotationRule(parsed.family, parsed.notation.style, parsed.notation.highest),
        unplaced=unplaced,
        roles=dict(cast("dict[str, str]", parsed.roles)),
        fault_label=parsed.unknown_fault.label if parsed.unknown_fault else "",
        fault_text=Text.from_mapping(parsed.unknown_fault.text) if parsed.unknown_fault else None,
        evidence=_section_evidence(parsed),
    )


def option_values(parsed: ProfileIn) -> dict[str, str | int | float | bool]:
    """Return the value of every option."""
    shared: dict[str, str | int | float | bool] = {m.MAXIMUM_FREQUENCY: 0} if parsed.setpoint.full_scale else {}
    shared |= {m.POLE_PAIRS: 0} if parsed.setpoint.rpm else {}
    shared |= {m.SETPOINT_STEP: m.UNDETERMINED} if _has_assumed_step(parsed) else {}
    return shared | {name: option.value for name, option in parsed.options.items()}


def _has_assumed_step(parsed: ProfileIn) -> bool:
    """Whether nothing proves the step of the setpoint, and no option of the file or of its family asks for it."""
    asked = {m.SETPOINT_STEP} & parsed.options.keys() or protocol_family(parsed.family).scale_option
    return parsed.setpoint.is_assumed and not asked


def parse_evidence(line: str) -> m.Evidence:
    """Split ``manual §4.2`` into kind and source."""
    kind, _, source = line.partition(" ")
    return m.Evidence(cast("Any", kind.rstrip(",:")), source)


def _build_scale(parsed: ScaleIn) -> Scale:
    return Scale(parsed.factor, parsed.offset, parsed.coding, parsed.decimals, parsed.words)


def _build_setpoint_scale(parsed: SetpointIn) -> Scale:
    step_hz = parsed.highest_hz / parsed.full_scale if parsed.full_scale and parsed.highest_hz else parsed.factor
    return Scale(step_hz, 0.0, parsed.coding, parsed.decimals, parsed.words)


def _build_setpoint_share(parsed: ProfileIn) -> m.SetpointShare | None:
    setpoint = parsed.setpoint
    if setpoint.full_scale is None or setpoint.highest_hz is None:
        return None
    parameter = parsed.parameters.get(setpoint.maximum or "")
    lowest_hz = setpoint.lowest_hz or (parameter.minimum if parameter else None) or (setpoint.maximum_hz or 0.0) / 2
    return m.SetpointShare(setpoint.full_scale, setpoint.maximum, setpoint.maximum_hz, lowest_hz, setpoint.highest_hz)


def _build_serial(parsed: ProfileIn) -> m.SerialDefaults:
    serial = parsed.serial
    return m.SerialDefaults(serial.baud, serial.format, tuple(serial.bauds), tuple(serial.formats))


def _build_signals(parsed: ProfileIn) -> dict[str, m.Signal]:
    """Build the signals whose address is known; others can't be polled."""
    placed = {}
    for name, signal in parsed.signals.items():
        locator = resolve_locator(parsed, signal.notation, signal)
        if isinstance(locator, tuple):
            placed[name] = _build_signal(name, signal, locator)
    return placed


def _build_signal(name: str, parsed: SignalIn, locator: Locator) -> m.Signal:
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


def _build_parameters(parsed: ProfileIn) -> tuple[dict[str, m.Parameter], dict[str, m.UnplacedParameter]]:
    """Build the parameters with an address, and the reason for each that has none."""
    placed: dict[str, m.Parameter] = {}
    unplaced: dict[str, m.UnplacedParameter] = {}
    for notation, parameter in parsed.parameters.items():
        locator = resolve_locator(parsed, notation, parameter)
        if isinstance(locator, tuple):
            chosen = option_values(parsed).get(parameter.maximum_option or "")
            maximum = float(chosen) if isinstance(chosen, int) else parameter.maximum
            placed[notation] = _build_parameter(notation, parameter, locator, maximum)
        elif isinstance(locator, Exception):
            described = _build_parameter(notation, parameter, ("unplaced", 0), parameter.maximum)
            unplaced[notation] = m.UnplacedParameter(described, Text.per_language(locator.text))
    return placed, unplaced


def _build_parameter(notation: str, parsed: ParameterIn, locator: Locator, maximum: float | None) -> m.Parameter:
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


def _uncertain_reason(parsed: ValueIn) -> str | None:
    return None if parsed.scale_published else "profiles.scale_unpublished"


def _build_preconditions(parsed: ProfileIn, unplaced: Mapping[str, m.UnplacedParameter]) -> tuple[m.Precondition, ...]:
    reasons = {notation: one.reason for notation, one in unplaced.items()}
    return tuple(
        m.Precondition(notation, tuple(wanted.accepted), Text.from_mapping(wanted.keypad), reasons.get(notation))
        for notation, wanted in parsed.preconditions.items()
    )


def _build_fault(code: int, parsed: Any) -> m.FaultEntry:
    cause, remedy = (Text.from_mapping(text) if text else None for text in (parsed.cause, parsed.remedy))
    return m.FaultEntry(
        code=code,
        label=parsed.label,
        text=Text.from_mapping(parsed.text),
        cause=cause,
        remedy=remedy,
        evidence=parse_evidence(parsed.evidence),
    )


def _build_modbus(parsed: ProfileIn) -> m.ModbusFeatures | None:
    rule = parsed.modbus
    if rule is None:
        return None
    return m.ModbusFeatures(
        functions=tuple(rule.functions),
        max_read=rule.max_read,
        error_form=rule.error_form,
        loopback=rule.loopback,
        word_order=rule.word_order,
        blocks=tuple((first, count) for first, count in rule.blocks),
        reply_count_bytes=rule.reply_count_bytes,
        rejected_read=rule.rejected_read,
        sync_block=(rule.sync_block[0], rule.sync_block[1]) if rule.sync_block else None,
    )


def _build_bit(parsed: BitIn) -> m.CommandBit:
    return m.CommandBit(parsed.mask, parsed.value, parsed.pulse)


def _build_match(parsed: WordMatchIn) -> m.WordMatch:
    return m.WordMatch(parsed.mask, parsed.value)


def _build_commands(parsed: CommandsIn | None) -> m.CommandMap | None:
    if parsed is None:
        return None
    variants = {
        setting: {value: {name: _build_bit(bit) for name, bit in bits.items()} for value, bits in choices.items()}
        for setting, choices in parsed.variants.items()
    }
    return m.CommandMap(
        register=parsed.register_,
        bits={name: _build_bit(bit) for name, bit in parsed.bits.items()},
        setpoint_register=parsed.setpoint_register,
        rewrite_levels_after_pulse=parsed.rewrite_levels_after_pulse,
        values=cast("dict[str, int]", dict(parsed.values)),
        variants=cast("Any", variants),
        words=parsed.words,
        written_to=parsed.written_to,
        coil_count=parsed.coil_count,
        reset=m.FixedWrite(parsed.reset.register_, parsed.reset.value) if parsed.reset else None,
        unlock=m.FixedWrite(parsed.unlock.register_, parsed.unlock.value) if parsed.unlock else None,
        preparation=tuple(
            m.StartStep(
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


def _build_status(parsed: StatusIn | None) -> m.StatusMap | None:
    if parsed is None:
        return None
    return m.StatusMap(
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


def _build_identity_codes(parsed: IdentityIn | None) -> m.IdentityCodes | None:
    if parsed is None or parsed.code_register is None:
        return None
    return m.IdentityCodes(parsed.code_register, {int(code, 16): tuple(names) for code, names in parsed.codes.items()})


def _build_span(parsed: OptionIn) -> tuple[int, int] | None:
    return (parsed.span[0], parsed.span[1]) if parsed.span else None


def _build_open_questions(parsed: ProfileIn) -> tuple[m.OpenQuestion, ...]:
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
            value=question.assumed,
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


def _setpoint_questions(parsed: ProfileIn) -> list[m.OpenQuestion]:
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
        shown = {"step_hz": f"{parsed.setpoint.factor:g}", "steps_hz": ", ".join(steps)}
        text, reason, procedure = (bilingual_text(f"profiles.setpoint_step_{part}", **shown) for part in parts)
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


def _section_evidence(parsed: ProfileIn) -> dict[str, m.Evidence]:
    names = ("serial", "timing", "limits", "setpoint", "write", "comm_loss", "commands", "status", "modbus", "identity")
    sections = {name: getattr(parsed, name) for name in names}
    return {name: parse_evidence(section.evidence) for name, section in sections.items() if section is not None}
