"""Answers → the text of a commented plant.toml, in the user's language. What it writes loads (a test)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from drivebus import i18n, profiles
from drivebus.plant.config.answers import Answers, DriveAnswer, LineAnswer, slug, unique
from drivebus.plant.config.schema import FORMAT

_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_PERIODS = {"output_frequency": "0.5", "output_current": "1.0"}
"""Signals of the examples, where a model has them."""


def written(answers: Answers, language: str) -> str:
    """The whole file. Raises ProfileError for a model that nobody knows."""
    return "\n".join(_file(answers, language)) + "\n"


def _file(answers: Answers, language: str) -> Iterator[str]:
    yield from comment("head", language)
    yield from (f"format = {FORMAT}", "", "[plant]", f"id = {text(slug(answers.title, 'plant'))}")
    yield f"title = {text(answers.title)}"
    yield from comment("plant", language)
    examples: _Examples | None = None
    ids: list[str] = []
    for index, line in enumerate(answers.lines):
        yield ""
        yield from _bus(index, line, language)
        for drive in line.drives:
            ids.append(unique(_wanted(drive), ids))
            yield from ("", *(comment("drive", language) if len(ids) == 1 else ()))
            yield from _drive(ids[-1], bus_id(index), drive, language)
            if examples is None:
                examples = _Examples(ids[0], drive.model)
                yield from comment("limits", language, asked=examples.asked)
    yield from examples.rules(ids, language) if examples is not None else ()


def bus_id(index: int) -> str:
    return _LETTERS[index] if index < len(_LETTERS) else f"line-{index + 1}"


def _wanted(drive: DriveAnswer) -> str:
    return slug(drive.title, f"{slug(Path(drive.model).stem, 'drive')}-{drive.address}")


def _bus(index: int, line: LineAnswer, language: str) -> Iterator[str]:
    yield from comment("bus", language) if index == 0 else ()
    yield from (f"[bus.{bus_id(index)}]", f"link = {text(line.link)}")
    if line.baud is not None:
        yield f"baud = {line.baud}"
    if line.format is not None:
        yield f"format = {text(line.format)}"


def _drive(id: str, bus: str, drive: DriveAnswer, language: str) -> Iterator[str]:
    yield from (f"[drive.{id}]", f'bus = "{bus}"', f"address = {drive.address}")
    sisters = comment_line("sisters", language, models=", ".join(drive.others)) if drive.others else ""
    yield f"model = {text(drive.model)}{sisters}"
    if drive.encoding is not None:
        yield f"encoding = {text(drive.encoding)}"
    if drive.title:
        yield f"title = {text(drive.title)}"


class _Examples:
    """What nobody could answer yet, as examples that are commented out and good: with a drive of this plant."""

    def __init__(self, drive: str, model: str) -> None:
        self._drive = drive
        self._profile = profiles.load(model)
        self._signals = [name for name in _PERIODS if name in self._profile.signals]

    @property
    def asked(self) -> str:
        """For ``signals``."""
        return "{ " + ", ".join(f"{name} = {_PERIODS[name]}" for name in self._signals) + " }"

    def _require(self, alone: bool) -> str | None:
        """For an interlock; None where the model reports nothing that could be required."""
        signal = self._profile.signals.get("output_frequency")
        if signal is None or signal.uncertain is not None:
            return None
        if alone:
            return f"{self._drive}.output_frequency <= 45 Hz"
        state = f"{self._drive}.state == running and " if "status" in self._profile.capabilities else ""
        return f"{state}{self._drive}.output_frequency >= 10 Hz"

    def rules(self, ids: list[str], language: str) -> Iterator[str]:
        drives = ", ".join(text(id) for id in ids)
        yield from ("", *comment("group", language, drives=drives))
        require = self._require(len(ids) == 1)
        if require is not None:
            yield from ("", *comment("interlock", language, last=ids[-1], require=require))
        if self._signals:
            signal = self._signals[-1]
            threshold = "45.0" if signal == "output_frequency" else "12.0"
            yield from ("", *comment("alarm", language, first=ids[0], signal=signal, threshold=threshold))
        yield from ("", *comment("history", language), "", *comment("web", language))


def comment(name: str, language: str, **params: str) -> list[str]:
    """A paragraph of the catalogues as comment lines."""
    said = i18n.text(f"plant_init.file_{name}", language, **params)
    return [f"# {line}".rstrip() for line in said.split("\n")]


def comment_line(name: str, language: str, **params: str) -> str:
    return "   # " + i18n.text(f"plant_init.file_{name}", language, **params)


def text(value: str) -> str:
    """A TOML string: JSON's escapes are TOML's, but for DEL, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
