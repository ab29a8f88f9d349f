"""Operations on the models that drivebus knows, whether or not the plant has such drives."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivebus.protocols.family import JogFrequency
from drivebus.service.api.operations.drive_view import FaultObject
from drivebus.service.api.operations.operation import (
    ApiObject,
    LocalizedText,
    Name,
    NoParams,
    Operation,
    OperationParams,
)
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class ModelParams(OperationParams):
    """Model that is described."""

    model: Annotated[Name, Field(examples=["vc660"])]


Grade = Literal["draft", "simulated", "verified"]


class FactorySerialObject(ApiObject):
    """Factory setting of the serial line."""

    baud: int
    format: str


class ModelObject(ApiObject):
    """A model; ``addresses`` are the lowest and the highest, ``broadcast`` the one of all stations."""

    model: str
    title: LocalizedText
    maker: LocalizedText
    family: str
    encodings: list[str]
    serial: FactorySerialObject
    addresses: list[int]
    broadcast: int | None
    grade: Grade
    capabilities: list[str]


class ModelsResponse(ApiObject):
    """Every model by name."""

    models: list[ModelObject]


class SerialObject(FactorySerialObject):
    """Settings of the serial line: the factory's, and those that the drive has."""

    bauds: list[int]
    formats: list[str]


class FrequencyLimitsObject(ApiObject):
    """Frequencies that the model can be given."""

    minimum_hz: float
    maximum_hz: float


class EvidenceObject(ApiObject):
    """Origin of a fact; ``source`` is the English of ``text``."""

    kind: str
    source: str
    text: LocalizedText


class ModelSignalObject(ApiObject):
    """A value that is polled, with the seconds between two polls."""

    name: str
    notation: str
    address_hex: str
    unit: str
    period_s: float
    text: LocalizedText
    evidence: EvidenceObject


class StatusBitObject(ApiObject):
    """A bit of the status word, which is the signal ``state``."""

    name: str
    mask: int
    text: LocalizedText


class ParameterObject(ApiObject):
    """A parameter. ``choices``: texts by raw word; where they are not ``choices_complete`` the drive accepts others."""

    notation: str
    address_hex: str
    text: LocalizedText
    unit: str
    minimum: float | None
    maximum: float | None
    choices: dict[str, LocalizedText]
    choices_complete: bool
    help: LocalizedText | None
    caveat: str | None
    writable: bool
    readable: bool
    factory: float | None
    evidence: EvidenceObject


class CaveatObject(ApiObject):
    """A warning for the user, with its source."""

    id: str
    text: LocalizedText
    evidence: EvidenceObject


class OpenQuestionObject(ApiObject):
    """A behaviour that the manuals leave open: the value in force, the reason, and how to determine it."""

    name: str
    value: str | int | float | bool
    choices: list[str | int | float | bool]
    text: LocalizedText
    reason: LocalizedText
    procedure: LocalizedText


class ProfileObject(ApiObject):
    """A model with everything that the page shows of it. ``keypad``: the steps before the bus may control it.

    ``status_bits`` is empty where the status word is a number or the model has none.
    """

    model: str
    maker: LocalizedText
    title: LocalizedText
    grade: Grade
    family: str
    encodings: list[str]
    serial: SerialObject
    limits: FrequencyLimitsObject
    capabilities: list[str]
    jog_frequency: JogFrequency | None
    signals: list[ModelSignalObject]
    status_bits: list[StatusBitObject]
    parameters: list[ParameterObject]
    faults: list[FaultObject]
    caveats: list[CaveatObject]
    keypad: list[LocalizedText]
    wiring: LocalizedText | None
    open_questions: list[OpenQuestionObject]
    can_save: bool
    can_write_ram: bool
    has_loopback: bool


MODELS_LIST = Operation(
    name="models.list",
    right=Right.VIEW,
    method="GET",
    path="/models",
    params=NoParams,
    response=ModelsResponse,
    summary=Text("Every model that drivebus knows", "drivebus 支持的全部型号"),
)

MODELS_GET = Operation(
    name="models.get",
    right=Right.VIEW,
    method="GET",
    path="/models/{model}",
    params=ModelParams,
    response=ProfileObject,
    summary=Text(
        "Profile of a model: signals, parameters, faults, caveats", "某型号的型号文件：信号、参数、故障、注意事项"
    ),
)
