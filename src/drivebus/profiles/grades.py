"""Grades of profiles: the requirements of the next grade that a profile does not meet yet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from drivebus import i18n
from drivebus.profiles.model import DriveProfile, Evidence

NEXT_GRADE = {"draft": "simulated", "simulated": "verified"}
"""Grade to the next higher one."""


@dataclass(frozen=True, slots=True)
class GradeRequirement:
    """Requirement of the next grade that a profile does not show to be met. Its text is ``grades.<kind>``."""

    kind: str
    params: dict[str, Any] = field(default_factory=dict)

    def text(self, language: str = "en") -> str:
        return i18n.text(f"grades.{self.kind}", language, **self.params)


def next_grade(profile: DriveProfile) -> str | None:
    """Return the grade above that of a profile, None for the highest."""
    return NEXT_GRADE.get(profile.grade)


def open_requirements(profile: DriveProfile) -> list[GradeRequirement]:
    """Return what the next grade requires and the file alone can't show, and the facts that rest on assumptions."""
    found: list[GradeRequirement] = []
    assumed = [name for name, evidence in _facts(profile) if evidence.kind == "assumed"]
    if profile.grade == "draft":
        found += [
            GradeRequirement("vectors", {"model": profile.model}),
            GradeRequirement("station"),
            GradeRequirement("second_source"),
        ]
    if profile.grade == "simulated":
        found.append(GradeRequirement("hardware"))
    if assumed and profile.grade != "verified":
        found.append(GradeRequirement("assumed", {"count": len(assumed), "names": tuple(assumed)}))
    questions = [question.name for question in profile.open_questions]
    if questions and profile.grade != "verified":
        found.append(GradeRequirement("questions", {"count": len(questions), "names": tuple(questions)}))
    return found


def _facts(profile: DriveProfile) -> Iterator[tuple[str, Evidence]]:
    """Yield each part of a profile that has evidence of its own."""
    yield from profile.evidence.items()
    yield from ((f"signals.{name}", signal.evidence) for name, signal in profile.signals.items())
    yield from ((f"parameters.{name}", parameter.evidence) for name, parameter in profile.parameters.items())
    yield from (
        (f"faults.{code}", fault.evidence) for code, fault in profile.faults.items() if fault.evidence is not None
    )
