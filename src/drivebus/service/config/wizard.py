"""What a new plant.toml is made of: what a scan found, or what somebody answered. Values, and their file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from drivebus.errors import ConfigurationError
from drivebus.profiles import schema_errors, toml_lines
from drivebus.profiles.diagnostics import issue, to_diagnostic
from drivebus.service.config.load import CATALOGUE, config_error, toml_complaint, unreadable_complaint
from drivebus.service.config.schema import ShortText, StrictModel


@dataclass(frozen=True, slots=True)
class DriveAnswer:
    """One drive of a line. ``others``: sister models that would answer alike."""

    address: int
    model: str
    title: str = ""
    encoding: str | None = None
    others: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BusAnswer:
    """One LINK and its drives. ``baud`` and ``format`` None: what the LINK says, or the factory."""

    link: str
    drives: tuple[DriveAnswer, ...]
    baud: int | None = None
    format: str | None = None


@dataclass(frozen=True, slots=True)
class PlantAnswers:
    """A whole plant."""

    title: str
    buses: tuple[BusAnswer, ...]


class _BusAnswerIn(StrictModel):
    link: Annotated[str, Field(min_length=1, max_length=1000)]
    model: ShortText
    addresses: Annotated[str, Field(pattern=r"^[0-9]{1,3}(-[0-9]{1,3})?(,[0-9]{1,3}(-[0-9]{1,3})?)*$")]
    names: list[ShortText] = []
    baud: int | None = None
    format: str | None = None
    encoding: str | None = None


class _PlantAnswersIn(StrictModel):
    title: ShortText = "plant"
    line: Annotated[list[_BusAnswerIn], Field(min_length=1)]


def read_answers(path: str) -> PlantAnswers:
    """``title`` and ``[[line]]`` tables with link, model, addresses (``1-3,7``), names. Raises ConfigurationError."""
    try:
        text = Path(path).read_text(encoding="utf-8")
        found = _PlantAnswersIn.model_validate(tomllib.loads(text))
    except OSError as error:
        raise config_error([unreadable_complaint(path, error)]) from None
    except UnicodeDecodeError as error:
        raise config_error(
            [to_diagnostic(issue("encoding", (), f"{error.object[error.start]:02X}H"), path, 1, CATALOGUE)]
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise config_error([toml_complaint(path, error, text)]) from None
    except ValidationError as error:
        faults = schema_errors.issues_from_pydantic(error, _PlantAnswersIn)
        raise config_error(
            [to_diagnostic(one, path, toml_lines.line_of(text, one.path), CATALOGUE) for one in faults]
        ) from None
    return PlantAnswers(found.title, tuple(_bus_answer(one) for one in found.line))


def _bus_answer(one: _BusAnswerIn) -> BusAnswer:
    addresses = parse_addresses(one.addresses)
    names = [*one.names, *[""] * len(addresses)]
    drives = (
        DriveAnswer(address, one.model, name, one.encoding) for address, name in zip(addresses, names, strict=False)
    )
    return BusAnswer(one.link, tuple(drives), one.baud, one.format)


def parse_addresses(text: str) -> list[int]:
    """``1-3,7`` → 1, 2, 3, 7. Raises ConfigurationError for a range that ends before it begins."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.partition("-")
        span = range(int(first), int(last if dash else first) + 1)
        if not span:
            raise ConfigurationError("plant_init.addresses", found=text)
        found += span
    return list(dict.fromkeys(found))


def id_from_title(text: str, otherwise: str) -> str:
    """An id from a title: lower case letters, digits and -."""
    found = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40].strip("-")
    return found or otherwise


def unique_id(wanted: str, taken: Iterable[str]) -> str:
    """``wanted``, with a number behind it where somebody has it."""
    known = set(taken)
    tries: Sequence[str] = [wanted, *(f"{wanted}-{number}" for number in range(2, len(known) + 3))]
    return next(one for one in tries if one not in known)
