"""Creation of a new ``plant.toml``: the answers of a scan or of questions, and the commented file made of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from drivebus import i18n, profiles
from drivebus.drives.dialects.setpoint_step import highest_safe_word, possible_steps_hz
from drivebus.errors import ConfigurationError
from drivebus.profiles.diagnostics import issues_from_pydantic, to_diagnostic
from drivebus.profiles.load import model_name
from drivebus.profiles.model import SETPOINT_STEP
from drivebus.profiles.schema import StrictTable
from drivebus.profiles.toml_file import TomlFault, decode_toml, line_of, toml_string
from drivebus.service.config.load import CATALOGUE, config_error, unreadable_file_diagnostic
from drivebus.service.config.schema import PLANT_FILE_FORMAT, ShortText
from drivebus.user_input import parse_addresses


@dataclass(frozen=True, slots=True)
class DriveAnswer:
    """Drive of a bus."""

    address: int
    model: str
    title: str = ""
    encoding: str | None = None
    _: KW_ONLY
    others: tuple[str, ...] = ()
    """Models that the bus can't tell from the one that the user stated."""
    is_doubtful: bool = False
    """Whether it answers unlike its model."""
    candidates: tuple[str, ...] = ()
    """Models that the drive may be where none was chosen: ``model`` is empty, and its table is commented out."""


@dataclass(frozen=True, slots=True)
class BusAnswer:
    """Bus and its drives. ``baud`` and ``format`` None: as the port URL says, else the factory settings."""

    port: str
    drives: tuple[DriveAnswer, ...]
    baud: int | None = None
    format: str | None = None


@dataclass(frozen=True, slots=True)
class PlantAnswers:
    """Plant of a new file."""

    title: str
    """Empty where it has none yet."""
    buses: tuple[BusAnswer, ...]


class _BusAnswerIn(StrictTable):
    port: Annotated[str, Field(min_length=1, max_length=1000)]
    model: ShortText
    addresses: Annotated[str, Field(pattern=r"^[0-9]{1,3}(-[0-9]{1,3})?(,[0-9]{1,3}(-[0-9]{1,3})?)*$")]
    names: list[ShortText] = []
    baud: int | None = None
    format: str | None = None
    encoding: str | None = None


class _PlantAnswersIn(StrictTable):
    title: ShortText = "plant"
    bus: Annotated[list[_BusAnswerIn], Field(min_length=1)]


def read_answers(path: str) -> PlantAnswers:
    """Read an answers file. Raises ConfigurationError.

    It has ``title`` and tables ``[[bus]]`` with port, model, addresses (``1-3,7``) and names.
    """
    try:
        text, data = decode_toml(Path(path).read_bytes())
        answers = _PlantAnswersIn.model_validate(data)
    except OSError as error:
        raise config_error([unreadable_file_diagnostic(path, error)]) from None
    except TomlFault as fault:
        raise config_error([to_diagnostic(fault.issue, path, fault.line, CATALOGUE)]) from None
    except ValidationError as error:
        faults = issues_from_pydantic(error, _PlantAnswersIn, data)
        raise config_error(
            [to_diagnostic(fault, path, line_of(text, fault.path), CATALOGUE) for fault in faults]
        ) from None
    return PlantAnswers(answers.title, tuple(_bus_answer(table) for table in answers.bus))


def _bus_answer(table: _BusAnswerIn) -> BusAnswer:
    """Return the answer of one bus. Raises ConfigurationError for addresses that can't be used."""
    try:
        addresses = parse_addresses(table.addresses, highest=999)  # the check of the written file names one too high
    except ValueError:
        raise ConfigurationError("plant_init.addresses", found=table.addresses) from None
    names, model = [*table.names, *[""] * len(addresses)], model_name(table.model)
    drives = (
        DriveAnswer(address, model, name, table.encoding) for address, name in zip(addresses, names, strict=False)
    )
    return BusAnswer(table.port, tuple(drives), table.baud, table.format)


def id_from_title(text: str, otherwise: str) -> str:
    """Return an id made from a title: lower case letters, digits and -."""
    id = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40].strip("-")
    return id or otherwise


def unique_id(preferred: str, taken: Iterable[str]) -> str:
    """Return ``preferred``, with a number appended if it is taken."""
    known = set(taken)
    tries: Sequence[str] = [preferred, *(f"{preferred}-{number}" for number in range(2, len(known) + 3))]
    return next(candidate for candidate in tries if candidate not in known)


_BUS_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_EXAMPLE_PERIODS = {"output_frequency": "0.5", "output_current": "1.0"}
"""Signals and periods of the examples."""


def plant_toml(answers: PlantAnswers, language: str) -> str:
    """Return the text of the file in a language. Raises ProfileError for an unknown model."""
    return "\n".join(_file_lines(answers, language)) + "\n"


def _file_lines(answers: PlantAnswers, language: str) -> Iterator[str]:
    yield from comment_lines("head", language)
    yield from (
        f"format = {PLANT_FILE_FORMAT}",
        "",
        "[plant]",
        f"id = {toml_string(id_from_title(answers.title, 'plant'))}",
    )
    yield f"title = {toml_string(answers.title)}"
    yield from comment_lines("plant", language)
    examples: _Examples | None = None
    ids: list[str] = []
    for index, bus in enumerate(answers.buses):
        yield ""
        yield from _bus_lines(index, bus, language)
        for drive in bus.drives:
            if drive.candidates:
                yield from ("", *_undecided_lines(bus_id(index), drive, language))
                continue
            ids.append(unique_id(_wanted_id(drive), ids))
            yield from ("", *(comment_lines("drive", language) if len(ids) == 1 else ()))
            yield from _drive_lines(ids[-1], bus_id(index), drive, language)
            if examples is None:
                examples = _Examples(ids[0], drive.model)
                yield from comment_lines("limits", language, asked=examples.signals)
    yield from examples.rules(ids, language) if examples is not None else ()


def bus_id(index: int) -> str:
    return _BUS_LETTERS[index] if index < len(_BUS_LETTERS) else f"bus-{index + 1}"


def _wanted_id(drive: DriveAnswer) -> str:
    return id_from_title(drive.title, f"{id_from_title(Path(drive.model).stem, 'drive')}-{drive.address}")


def _bus_lines(index: int, bus: BusAnswer, language: str) -> Iterator[str]:
    yield from comment_lines("bus", language) if index == 0 else ()
    yield from (f"[bus.{bus_id(index)}]", f"port = {toml_string(bus.port)}")
    if bus.baud is not None:
        yield f"baud = {bus.baud}"
    if bus.format is not None:
        yield f"format = {toml_string(bus.format)}"


def _drive_lines(id: str, bus: str, drive: DriveAnswer, language: str) -> Iterator[str]:
    yield from (f"[drive.{id}]", f'bus = "{bus}"', f"address = {drive.address}")
    comment = trailing_comment("sisters", language, models=drive.others) if drive.others else ""
    comment = trailing_comment("doubtful", language) if drive.is_doubtful and not drive.others else comment
    yield f"model = {toml_string(drive.model)}{comment}"
    profile = profiles.load(drive.model)
    steps_hz = possible_steps_hz(profile, profile.options)
    if len(steps_hz) > 1:
        cap = f"{profile.setpoint_scale.value(highest_safe_word(steps_hz)):g}"
        step = toml_string(f"{profile.setpoint_scale.factor:g}")
        yield f"# options = {{ {SETPOINT_STEP} = {step} }}{trailing_comment('setpoint_step', language, cap=cap)}"
    if drive.encoding is not None:
        yield f"encoding = {toml_string(drive.encoding)}"
    if drive.title:
        yield f"title = {toml_string(drive.title)}"


def _undecided_lines(bus: str, drive: DriveAnswer, language: str) -> Iterator[str]:
    """Yield the table of a drive commented out: the model in it is no model until the user writes one."""
    reason = "undecided" if len(drive.candidates) > 1 else "unlike"
    yield from comment_lines(reason, language, address=str(drive.address), models=drive.candidates)
    yield from (f"# [drive.{bus}-{drive.address}]", f'# bus = "{bus}"', f"# address = {drive.address}", '# model = "?"')
    if drive.encoding is not None:
        yield f"# encoding = {toml_string(drive.encoding)}"


class _Examples:
    """Commented-out examples with a drive and signals of this plant; uncommented they are valid."""

    def __init__(self, drive: str, model: str) -> None:
        self._drive = drive
        self._profile = profiles.load(model)
        self._signals = [name for name in _EXAMPLE_PERIODS if name in self._profile.signals]

    @property
    def signals(self) -> str:
        """Value of ``signals``."""
        return "{ " + ", ".join(f"{name} = {_EXAMPLE_PERIODS[name]}" for name in self._signals) + " }"

    def _require(self, *, alone: bool) -> str | None:
        """Return the condition of an interlock; None if the model reports nothing suitable."""
        signal = self._profile.signals.get("output_frequency")
        if signal is None or signal.uncertain is not None:
            return None
        if alone:
            return f"{self._drive}.output_frequency <= 45 Hz"
        state = f"{self._drive}.state == running and " if "status" in self._profile.capabilities else ""
        return f"{state}{self._drive}.output_frequency >= 10 Hz"

    def rules(self, ids: list[str], language: str) -> Iterator[str]:
        drives = ", ".join(toml_string(id) for id in ids)
        yield from ("", *comment_lines("group", language, drives=drives))
        require = self._require(alone=len(ids) == 1)
        if require is not None:
            yield from ("", *comment_lines("interlock", language, last=ids[-1], require=require))
        if self._signals:
            signal = self._signals[-1]
            threshold = "45.0" if signal == "output_frequency" else "12.0"
            yield from ("", *comment_lines("alarm", language, first=ids[0], signal=signal, threshold=threshold))
        yield from ("", *comment_lines("history", language), "", *comment_lines("web", language))


def comment_lines(name: str, language: str, **params: Any) -> list[str]:
    """Return a message of the catalogue as comment lines."""
    text = i18n.text(f"plant_init.file_{name}", language, **params)
    return [f"# {line}".rstrip() for line in text.split("\n")]


def trailing_comment(name: str, language: str, **params: Any) -> str:
    return "   # " + i18n.text(f"plant_init.file_{name}", language, **params)
