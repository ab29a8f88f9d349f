"""Grades of profiles: what a profile lacks for its next one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from drivebus import i18n
from drivebus.profiles.model import DriveProfile, Evidence

NEXT_GRADE = {"draft": "simulated", "simulated": "verified"}
"""Grade to the next higher one."""


@dataclass(frozen=True, slots=True)
class Lack:
    """Condition of the next grade that is not shown by the profile itself. Its text is ``grades.<kind>``."""

    kind: str
    params: dict[str, Any] = field(default_factory=dict)

    def text(self, language: str = "en") -> str:
        return i18n.text(f"grades.{self.kind}", language, **self.params)


def next_grade(profile: DriveProfile) -> str | None:
    """Return the grade above that of a profile, None for the highest."""
    return NEXT_GRADE.get(profile.grade)


def lacks(profile: DriveProfile) -> list[Lack]:
    """Return what the next grade asks for and the file alone can't show, and the facts that rest on assumptions."""
    lacking: list[Lack] = []
    assumed = [name for name, evidence in _facts(profile) if evidence.kind == "assumed"]
    if profile.grade == "draft":
        lacking += [Lack("vectors", {"model": profile.model}), Lack("station"), Lack("second_source")]
    if profile.grade == "simulated":
        lacking.append(Lack("hardware"))
    if assumed and profile.grade != "verified":
        lacking.append(Lack("assumed", {"count": len(assumed), "names": tuple(assumed)}))
    questions = [question.name for question in profile.open_questions]
    if questions and profile.grade != "verified":
        lacking.append(Lack("questions", {"count": len(questions), "names": tuple(questions)}))
    return lacking


def _facts(profile: DriveProfile) -> Iterator[tuple[str, Evidence]]:
    """Yield each part of a profile that has evidence of its own."""
    yield from profile.evidence.items()
    yield from ((f"signals.{name}", signal.evidence) for name, signal in profile.signals.items())
    yield from ((f"parameters.{name}", parameter.evidence) for name, parameter in profile.parameters.items())
    yield from (
        (f"faults.{code}", fault.evidence) for code, fault in profile.faults.items() if fault.evidence is not None
    )
