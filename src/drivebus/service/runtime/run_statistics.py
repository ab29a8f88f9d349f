"""Run statistics of drives: hours, starts, energy, peaks and faults.

Only observations count. A drive that does not report its state has no hours (None, not 0), one without a power in kW
has no energy.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from pydantic import Field, StrictBool, TypeAdapter, ValidationError

from drivebus import i18n
from drivebus.clock import wall_ms
from drivebus.drives.state import DriveState
from drivebus.errors import ServiceUnavailable
from drivebus.service.historian import Historian
from drivebus.service.live.views import DriveView, SignalView
from drivebus.types import Json
from drivebus.values import Quality

LOG = logging.getLogger("drivebus.service")
DOCUMENT_KIND = "statistics"
SAVE_INTERVAL_S = 60.0  # hours and energy that a killed service loses at most; starts and trips are saved at once
LOAD_RETRY_S = 10.0
LOAD_TIMEOUT_S = 1.0  # a database that does not answer delays the start of the service by no more
MAX_COUNT = 2**53  # a stored number beyond it was not counted here
StoredInt = Annotated[int, Field(strict=True, ge=-MAX_COUNT, le=MAX_COUNT)]
StoredFloat = Annotated[float, Field(strict=True, ge=-MAX_COUNT, le=MAX_COUNT, allow_inf_nan=False)]
MAX_OBSERVATION_GAP_S = 5.0
"""The time between two observations counts only up to this."""

_RUNNING_TIME_STATES = frozenset(state for state in DriveState if state.turning and state is not DriveState.PAUSED)


@dataclass(slots=True, kw_only=True)
class RunStatistics:
    """Numbers of one drive since ``since_ms``, in UTC milliseconds."""

    since_ms: StoredInt | None = None
    running_s: StoredFloat | None = None
    starts: StoredInt | None = None
    energy_kwh: StoredFloat | None = None
    """Energy of the drive's output; energy of a braking motor is subtracted."""
    maximum_current_a: StoredFloat | None = None
    maximum_temperature_c: StoredFloat | None = None
    faults: dict[str, StoredInt] = field(default_factory=dict)
    """Fault code → number of trips."""
    turned: StrictBool | None = None
    """Whether the motor turned at the last observation with a known state."""
    fault: str | None = None
    """Fault code at that observation."""
    _observed_at: float | None = field(default=None, init=False, compare=False)
    _power_kw: float | None = field(default=None, init=False, compare=False)

    @staticmethod
    def from_document(stored: Any) -> RunStatistics:
        """Return stored statistics; unknown fields are ignored. Raises ValidationError for anything else."""
        return _ADAPTER.validate_python(stored)

    def to_document(self) -> Json:
        document: Json = _ADAPTER.dump_python(self, exclude=_NOT_STORED)
        return document

    @property
    def counts(self) -> tuple[int, int]:
        """Number of starts and of trips."""
        return self.starts or 0, sum(self.faults.values())

    def observe(self, view: DriveView, now: float, now_ms: int) -> None:
        """Take in a view at ``now``, in monotonic seconds; ``now_ms`` only labels the first one."""
        if self.since_ms is None:
            self.since_ms = now_ms
        passed_s = (
            None
            if self._observed_at is None or now - self._observed_at > MAX_OBSERVATION_GAP_S
            else now - self._observed_at
        )
        self._observed_at = now
        self._count_energy(_power_kw(view), passed_s)
        self.maximum_current_a = _maximum(self.maximum_current_a, _good_value(view.signals.get("output_current"), "A"))
        for name, signal in view.signals.items():
            if name.endswith("temperature"):
                self.maximum_temperature_c = _maximum(self.maximum_temperature_c, _good_value(signal, "°C"))
        if view.presence == "online" and view.state != DriveState.UNKNOWN:
            self._count_state(view, passed_s)

    def _count_state(self, view: DriveView, passed_s: float | None) -> None:
        """Count what follows from a known state."""
        turns = view.state in _RUNNING_TIME_STATES
        self.running_s, self.starts = self.running_s or 0.0, self.starts or 0
        if turns and self.turned and passed_s is not None:
            self.running_s += passed_s
        if turns and self.turned is False:
            self.starts += 1
        self.turned = turns
        code = None if view.fault is None else str(view.fault.get("code"))
        if code is not None and code != self.fault:
            self.faults[code] = self.faults.get(code, 0) + 1
        self.fault = code

    def _count_energy(self, power_kw: float | None, passed_s: float | None) -> None:
        """Add the power of the last observation for the time since."""
        if self._power_kw is not None and passed_s is not None:
            self.energy_kwh = (self.energy_kwh or 0.0) + self._power_kw * passed_s / 3600.0
        elif power_kw is not None and self.energy_kwh is None:
            self.energy_kwh = 0.0
        self._power_kw = power_kw

    def as_json(self) -> Json:
        """Return the result of ``drives.statistics``."""
        return {
            "running_h": None if self.running_s is None else round(self.running_s / 3600.0, 4),
            "starts": self.starts,
            "energy_kwh": None if self.energy_kwh is None else round(self.energy_kwh, 3),
            "maximum_current_a": self.maximum_current_a,
            "maximum_temperature_c": self.maximum_temperature_c,
            "faults": dict(self.faults),
            "since_ms": self.since_ms,
        }


_ADAPTER = TypeAdapter(RunStatistics)
_NOT_STORED = {each.name for each in fields(RunStatistics) if not each.init}
"""Fields of the last observation, which only the next one needs."""


def _good_value(signal: SignalView | None, unit: str) -> float | None:
    """Return a good value in that unit; a raw value of unknown scale is None."""
    if signal is None or signal.quality is not Quality.GOOD or signal.unit != unit:
        return None
    return float(signal.value) if isinstance(signal.value, int | float) else None


def _power_kw(view: DriveView) -> float | None:
    return _good_value(view.signals.get("output_power"), "kW")


def _maximum(first: float | None, second: float | None) -> float | None:
    known = [value for value in (first, second) if value is not None]
    return max(known, default=None)


class RunStatisticsStore:
    """Run statistics of all drives, kept by the historian."""

    def __init__(self, historian: Historian) -> None:
        self._historian = historian
        self._drives: dict[str, RunStatistics] = {}
        self._saved_at: dict[str, float] = {}
        self._task: asyncio.Task[None] | None = None
        self.is_loaded = False
        self.damaged_copy = ""
        """Kind under which the history keeps documents that could not be read at ``open``; empty if all could be."""

    async def open(self) -> None:
        """Load the stored statistics; repeat it while the database does not answer."""
        self._task = asyncio.create_task(self._load(), name="run statistics")
        await asyncio.wait({self._task}, timeout=LOAD_TIMEOUT_S)

    async def close(self) -> None:
        """Save everything; the historian closes after this."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        for drive in self._drives:
            self._save(drive)

    async def _load(self) -> None:
        while not self.is_loaded:
            try:
                stored = await self._historian.documents(DOCUMENT_KIND)
            except ServiceUnavailable:
                await asyncio.sleep(LOAD_RETRY_S)
                continue
            for drive, document in stored.items():
                try:
                    self._drives[drive] = RunStatistics.from_document(document)
                except ValidationError:
                    self._put_aside(drive, document)
            self.is_loaded = True

    def _put_aside(self, drive: str, document: Any) -> None:
        """Keep a document that can't be read under a kind of its own; the drive is counted from now on."""
        self.damaged_copy = self.damaged_copy or f"{DOCUMENT_KIND}.damaged-{wall_ms()}"
        self._historian.put_document(self.damaged_copy, drive, document)
        LOG.error(i18n.preferred_text("log.statistics_damaged", drive=drive, copy=self.damaged_copy))

    def on_view(self, view: DriveView, now: float, now_ms: int) -> None:
        """Take in an observation. Nothing is counted, or overwritten, before the stored statistics are known."""
        if not self.is_loaded:
            return
        statistics = self._drives.get(view.id)
        if statistics is None:
            statistics = self._drives[view.id] = RunStatistics()
        counts = statistics.counts
        statistics.observe(view, now, now_ms)
        if statistics.counts != counts or now - self._saved_at.setdefault(view.id, now) >= SAVE_INTERVAL_S:
            self._save(view.id)
            self._saved_at[view.id] = now

    def _save(self, drive: str) -> None:
        self._historian.put_document(DOCUMENT_KIND, drive, self._drives[drive].to_document())

    def statistics_json(self, drive: str) -> Json:
        return self._drives.get(drive, RunStatistics()).as_json()
