"""What the plant answers, for the API's description: nothing is checked or cut on its way out, and keys may be added
(the stability promise), so every object here may have more than is written.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class ApiObject(BaseModel):
    """An object of the API; keys may be added to it."""

    model_config = ConfigDict(extra="allow")


class LocalizedText(ApiObject):
    """A text in both languages."""

    en: str
    zh: str


class ExchangeObject(ApiObject):
    """One frame of a command and what came back, as hex with blanks; seconds of the plant's monotonic clock."""

    sent: str
    received: str
    sent_at_s: float | None
    received_at_s: float | None
    error: str | None
    """The key of a sentence; ``params`` are its own."""
    params: dict[str, Any] = {}


class NoteObject(ApiObject):
    """A sentence besides."""

    key: str
    text: LocalizedText


class OutcomeObject(ApiObject):
    """How a command ended. ``confirmed``: a later read shows the effect; ``acknowledged``: the drive said yes and
    nothing can show it; ``unknown``: sent, and nobody can say whether it was done.
    """

    word: Literal["confirmed", "acknowledged", "refused", "failed", "unknown"]
    key: str
    text: LocalizedText
    params: dict[str, Any]
    notes: list[NoteObject]
    frames: list[ExchangeObject]
    command: str | None = None
    """Under which id the audit trail has it."""


class ErrorObject(ApiObject):
    """Why not. ``code`` stays for ever; ``text`` may be worded better."""

    code: str = Field(examples=["drives.above_maximum"])
    kind: str = Field(examples=["LimitError"])
    text: LocalizedText
    params: dict[str, Any]
    outcome: OutcomeObject | None
    status: int = Field(examples=[422])


class ErrorResponse(ApiObject):
    """The one shape of every error."""

    error: ErrorObject


class StopCountsObject(ApiObject):
    """Stops of single drives; a stop of everything is one of each drive. What is in neither of the last two was not
    confirmed in time.
    """

    asked: int
    confirmed: int
    acknowledged: int


class StatisticsResponse(ApiObject):
    """Since the service began; ``drives``: each drive's own, as its address ``statistics`` answers."""

    stops: StopCountsObject
    history: dict[str, Any]
    drives: dict[str, dict[str, Any]]


class SignalObject(ApiObject):
    """One value with its trust; ``reason`` says why it is not good, ``age_s`` is null where it was never read."""

    value: float | int | str | None
    unit: str
    quality: Literal["good", "uncertain", "bad"]
    reason: str | None
    age_s: float | None


class CommLossObject(ApiObject):
    """What the drive does when the host dies."""

    kind: Literal["trips", "runs_on", "unknown"]
    after_s: float | None
    text: LocalizedText | None
    waiver: Any = None


class LeaseObject(ApiObject):
    """Who may command the drive."""

    owner: str
    session: str
    expires_in_s: float


class DriveObject(ApiObject):
    """One drive as the plant knows it now."""

    id: str
    title: LocalizedText | None
    bus: str
    address: int
    model: str
    grade: str
    capabilities: list[str]
    directions: list[str]
    groups: list[str]
    presence: Literal["online", "offline", "never_seen"]
    state: str
    state_reason: str | None
    direction: Literal["forward", "reverse"] | None
    fault: dict[str, Any] | None
    commanded_hz: float | None
    minimum_hz: float
    maximum_hz: float
    host_dies: CommLossObject
    lease: LeaseObject | None
    latched: bool
    stop_pending: bool
    blocked: list[dict[str, Any]]
    alarms: dict[str, int]
    signals: dict[str, SignalObject]
    state_age_s: float | None
    jog_frequency: Literal["drive", "asked", "either"] | None


class DrivesResponse(ApiObject):
    drives: list[DriveObject]


class OutcomeResponse(ApiObject):
    outcome: OutcomeObject


class LeaseResponse(ApiObject):
    lease: LeaseObject
    ttl_s: float


class ArmResponse(ApiObject):
    """The second step, ``run``, needs ``arm`` within ``expires_s``."""

    arm: str
    expires_s: float


class JogResponse(ApiObject):
    """The motor turns while ``jog`` is renewed within ``lease_s``."""

    jog: str
    lease_s: float
    outcome: OutcomeObject


class OutcomesResponse(ApiObject):
    """An outcome or an error for each drive."""

    outcomes: dict[str, dict[str, Any]]


class BusStopObject(ApiObject):
    confirmed: bool
    unconfirmed: list[str]
    took_s: float | None


class StopAllResponse(OutcomesResponse):
    buses: dict[str, BusStopObject]


class PageResponse(ApiObject):
    """A part of a list; ``next`` is the ``cursor`` of the next part, null at the end. A cursor is opaque."""

    items: list[dict[str, Any]]
    next: str | None


class GroupsResponse(ApiObject):
    groups: list[dict[str, Any]]


class BusesResponse(ApiObject):
    buses: list[dict[str, Any]]


class FramesResponse(ApiObject):
    """Decoded frames; ``last`` is what ``after`` takes to go on."""

    frames: list[dict[str, Any]]
    last: int


class TagsResponse(ApiObject):
    tags: list[dict[str, Any]]


class TrendSeriesObject(ApiObject):
    """At most 1,000 points; null is a gap. ``q``: 0 good, 1 uncertain, 2 bad."""

    t: list[int]
    min: list[float | None]
    mean: list[float | None]
    max: list[float | None]
    q: list[int]


class TrendResponse(ApiObject):
    resolution: Literal["raw", "1s", "1min", "1h"]
    series: dict[str, TrendSeriesObject]


class ParametersResponse(ApiObject):
    parameters: dict[str, dict[str, Any]]


class ActiveAlarmsResponse(ApiObject):
    active: list[dict[str, Any]]


class AuditVerificationResponse(ApiObject):
    ok: bool
    entries: int
    problems: list[dict[str, Any]]
