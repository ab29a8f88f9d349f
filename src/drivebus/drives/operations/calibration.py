"""Calibration steps: a person beside the drive helps to determine what its manual leaves open.

A family lists its steps in ``ProtocolFamily.calibrations``; the step of the setpoint may be open in every family. Each
step determines an undocumented option of one drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus.drives.dialects.base import Dialect
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.outcome import Outcome
from drivebus.errors import CapabilityError
from drivebus.protocols.family import protocol_family, resolve

SETPOINT_STEP_CALIBRATION = "drivebus.drives.operations.setpoint_step_calibration:STEPS"
PlannedRequests = tuple[tuple[str, tuple[Any, ...]], ...]
"""Purpose (a catalogue key without its ``dry.``) and requests, in the order of sending."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResult:
    """Result of a calibration step."""

    options: Mapping[str, Any] = field(default_factory=dict)
    """Options that the step determined; empty where they stay open."""
    candidates: tuple[str, ...] = ()
    """Values that are still possible."""
    words: tuple[int, ...] = ()
    """Raw words that were read or sent."""
    outcome: Outcome | None = None
    """Outcome of the motion of a step that a person observes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationStep:
    """Calibration step of a family."""

    name: str
    option: str
    """Option of the drive that this step determines."""
    undetermined: Any
    """Value of the option until this step has determined it."""
    moves: bool
    """The motor turns: the drive is stopped until that is confirmed, however the step ends."""
    operation: Callable[..., DriveOperation[CalibrationResult]]
    """``(operation context, **inputs)``; every input has a default."""
    plan: Callable[[Any], PlannedRequests]
    """``(dialect)`` to the requests that it would send, for ``--dry-run``."""
    question: str
    """Catalogue key of the question that a person confirms first."""
    question_params: Mapping[str, Any] = field(default_factory=dict)
    observation_question: str | None = None
    """Catalogue key of the question about the motion; None where the step needs no observation."""
    observations: Mapping[str, Any] = field(default_factory=dict)
    """Key of the keyboard to the observation that it stands for."""
    options_observed: Callable[[Any], Mapping[str, Any]] = lambda observation: {}
    """Options that an observation determines."""

    def is_open(self, options: Mapping[str, Any]) -> bool:
        """Return whether these options of a drive leave the step to be done."""
        return self.option in options and options[self.option] == self.undetermined


def calibration_steps(dialect: Dialect) -> tuple[CalibrationStep, ...]:
    """Return the steps of a drive, determined or not, in the order of their dependencies."""
    own = protocol_family(dialect.profile.family).calibrations
    steps: tuple[CalibrationStep, ...] = (*resolve(SETPOINT_STEP_CALIBRATION), *resolve(own))
    return tuple(step for step in steps if step.option in dialect.options)


def calibration_step(dialect: Dialect, name: str) -> CalibrationStep:
    """Return a step by name. Raises CapabilityError where the drive has none of this name."""
    for step in calibration_steps(dialect):
        if step.name == name:
            return step
    raise CapabilityError("drives.cannot", model=dialect.profile.model, what=f"calibrate {name}")
