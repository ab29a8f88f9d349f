"""Runtime of one drive: the drive, its monitor, and its state in the service."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from math import inf
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.station import Presence
from drivebus.drives import Drive, DriveState, DriveStatus
from drivebus.drives.context import DriveLimits
from drivebus.drives.monitor import Monitor
from drivebus.drives.operations.status import complete_status
from drivebus.drives.outcome import Outcome
from drivebus.drives.speed_progress import SpeedDifference
from drivebus.drives.state import STATE_NOT_READ
from drivebus.drives.store import Store
from drivebus.errors import Superseded
from drivebus.service.config.bus_load import polled_names, polls_of, with_periods
from drivebus.service.config.model import DriveConfig
from drivebus.service.live.views import Sample, StopObject
from drivebus.service.runtime.comm_loss import CommLossState
from drivebus.service.runtime.failure_log import failure_logged
from drivebus.service.storage.settings import DriveIdentity
from drivebus.values import Quality, Reading

FREQUENCY_TOLERANCE_HZ = 0.1  # rounding of a frequency by the drive is no excess over a limit


class DriveRuntime:
    """A drive of the plant.

    ``on_status`` is called with every new status of its monitor, ``on_repeated_stop`` as that of ``Drive``.
    """

    def __init__(
        self,
        config: DriveConfig,
        bus: Bus,
        *,
        on_status: Callable[[DriveRuntime, DriveStatus], None],
        on_repeated_stop: Callable[[DriveRuntime, Outcome], None],
        store: Store | None,
    ) -> None:
        self.config, self.bus, self._on_status = config, bus, on_status
        self.id = config.id
        self._model_profile = profiles.load(config.model)
        """Profile with its own periods. A changed file of it is read when the drive is added again."""
        self.profile = with_periods(self._model_profile, config.signals)
        self.signals = polled_names(config, self.profile)
        """Polled signals: those that the configuration names, else all of the profile."""
        self.drive = Drive(
            bus,
            self.profile,
            config.address,
            encoding=config.encoding,
            limits=config.limits,
            options=config.options,
            store=store,
            on_repeated_stop=partial(on_repeated_stop, self),
        )
        self.polls = polls_of(config, self.drive.dialect)
        self.monitor: Monitor | None = None
        self.comm_loss = CommLossState()
        self.group_started_at: float | None = None
        """Monotonic time of its last start by a group."""
        self.limits_lost = False
        """The limits that an engineer set are lost with their file: it is not started until they are set again."""
        self.limits_set_for: DriveIdentity | None = None
        """Drive for which its limits were set, where that was another one."""
        self.last_stop: StopObject | None = None
        """Its last stop request, until it is started again."""
        self.stop_record: int | None = None
        """Number of the audit record of ``last_stop``, where that is known."""
        self.commanded_hz: float | None = None
        self.speed_difference = SpeedDifference()
        """Difference of the speed that it reports from ``commanded_hz``."""
        self.started_by_service = False
        """Started by this service and not reported at standstill since."""
        self.adopted = False
        """Found running when this service started, and not reported at standstill since."""
        self.ramp_holds = 0
        """Ramp holds that have not ended: their end is still to be sent."""
        self.added_at = 0.0
        """Monotonic time at which it was added, at the start or by a reload; earlier frames are of another motor."""
        self.last_motion_at = 0.0
        """Monotonic time at which its last start ended; infinite while one is under way."""
        self._starts_under_way = 0
        self._started_before = False
        """Value that ``started_by_service`` gets back if no start under way can have let a motor run."""
        self._motions_sent_before = 0
        """``Bus.motions_sent`` when the first of the starts under way began."""
        self.state_was_known = False
        """Its state was known at least once since this service started."""
        self.last_known_turning = False
        """Its motor turned when its state was known last, by whichever start."""
        self.reported_unusable_reply = False
        """Whether an event of its absence has named the invalid replies that it sends."""
        self.reported_presence: Presence | None = None
        """Presence of which an event was published last."""
        self.reported_fault: int | None = None
        """Code of the fault of which an event was published last."""
        self.unnamed_fault_at: float | None = None
        """Monotonic time since which it has reported a fault without a code."""
        self._last_sampled: dict[str, float | None] = {}

    def withdraw_commands(self, why: Superseded) -> None:
        """Send nothing more of the commands under way, see ``Drive.withdraw_commands``.

        A start of which no frame that moves was sent no longer counts as one by this service.
        """
        self.drive.withdraw_commands(why)
        if self._starts_under_way and self.bus.motions_sent(self.drive.address) == self._motions_sent_before:
            self.started_by_service = self._started_before

    def begin_start(self) -> None:
        """Count the drive as started by this service until ``end_start``."""
        if not self._starts_under_way:
            self._started_before = self.started_by_service
            self._motions_sent_before = self.bus.motions_sent(self.drive.address)
        self._starts_under_way += 1
        self.started_by_service, self.last_motion_at = True, inf

    def end_start(self, now: float, *, started: bool) -> None:
        """End what ``begin_start`` began. ``started`` false leaves ``started_by_service`` as it was before."""
        self._starts_under_way -= 1
        self._started_before |= started
        self.started_by_service |= started
        if not self._starts_under_way:
            self.started_by_service, self.last_motion_at = self._started_before, now

    @property
    def runs_for_service(self) -> bool:
        """Started or adopted by this service, and not reported at standstill since; or found running just now."""
        return self.started_by_service or self.adopted or (not self.state_was_known and self.turning)

    @property
    def may_be_running(self) -> bool:
        """Whether its motor turns, or was started or adopted and has not been reported at standstill since."""
        return self.runs_for_service or self.turning

    @property
    def may_turn(self) -> bool:
        """Whether it may be running, or its state is not known now although it answers, and it turned the last time."""
        return self.may_be_running or (self.is_online and self.state_is_unknown and self.last_known_turning)

    @property
    def turning(self) -> bool:
        """Whether its motor turns; where its status can't be made, whether it turned when its state was known last."""
        return self._turns_by(self.status_or_none())

    def _turns_by(self, status: DriveStatus | None) -> bool:
        return self.last_known_turning if status is None else status.state.turning

    @property
    def decelerating(self) -> bool:
        """Whether it reports that it decelerates."""
        status = self.status_or_none()
        return status is not None and status.state is DriveState.DECELERATING

    @property
    def state_is_unknown(self) -> bool:
        """Whether its state is not known now, also because its status can't be made."""
        status = self.status_or_none()
        return status is None or status.state is DriveState.UNKNOWN

    @property
    def has_status(self) -> bool:
        """Whether its status can be made."""
        return self.status_or_none() is not None

    @property
    def is_online(self) -> bool:
        """Whether it has answered its last request."""
        return self.bus.presence(self.config.address) is Presence.ONLINE

    @property
    def awaits_first_read(self) -> bool:
        """Whether its first read is under way: the state is not known, and no poll has failed."""
        status = self.status_or_none()
        not_read = status is not None and status.reason == STATE_NOT_READ.reason
        return not_read and self.monitor is not None and self.monitor.last_error is None

    def end_motion(self) -> None:
        """Record that it stands still: a later motion is not of this service, nor at its frequency."""
        if self.state_is_unknown:
            self.last_known_turning = False
        if self.started_by_service or self.adopted:
            self.commanded_hz = None
        self.started_by_service = self._started_before = self.adopted = False

    def reconfigure(self, setting: DriveConfig, *, polls: bool) -> None:
        """Apply changed limits and policies, and with ``polls`` changed polling."""
        self.config = setting
        if polls:
            self.profile, watched = with_periods(self._model_profile, setting.signals), self.monitor is not None
            self.signals = polled_names(setting, self.profile)
            self.drive.set_poll_periods(self.profile)
            self.polls = polls_of(setting, self.drive.dialect)
            self.stop_monitor()
            if watched:
                self.start_monitor()

    def start_monitor(self) -> None:
        """Begin to poll. The bus is open, so that earlier calibrations on this port are found."""
        self.monitor = self.monitor or self.drive.monitor(
            self.signals, partial(self._on_status, self), self.config.min_poll_interval_s
        )

    def status(self) -> DriveStatus:
        """Return the newest status; old readings are bad and an old state is unknown."""
        if self.monitor is not None:
            return self.monitor.status()
        return complete_status(self.drive.dialect, DriveStatus(state=DriveState.UNKNOWN, reason="drives.not_read"), ())

    def status_or_none(self) -> DriveStatus | None:
        """Return the newest status; log why it can't be made, so that one drive keeps no stop from the others."""
        with failure_logged():
            return self.status()
        return None

    @property
    def configured_range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that profile and configuration allow."""
        model, file = self.profile.limits, self.config.limits
        highest = model.maximum_hz if file.maximum_hz is None else min(model.maximum_hz, file.maximum_hz)
        return max(model.minimum_hz, file.minimum_hz), highest

    def above_limit_hz(self, status: DriveStatus | None) -> float | None:
        """Return the frequency at which it runs or to which it was set, where that is above its limit.

        A new limit slows no motor. ``status``: its present one, None where that can't be made.
        """
        read = None if status is None else status.readings.get("output_frequency")
        is_read = read is not None and read.quality is Quality.GOOD and isinstance(read.value, int | float)
        read_hz = float(read.value) if is_read else 0.0  # type: ignore[union-attr, arg-type]
        set_hz = self.commanded_hz if self.runs_for_service else None  # else it was started at its keypad
        frequency_hz = max(read_hz, set_hz or 0.0)
        is_above = frequency_hz > self.drive.range_hz[1] + FREQUENCY_TOLERANCE_HZ
        return frequency_hz if is_above and (self.runs_for_service or self._turns_by(status)) else None

    def set_limits(self, own: DriveLimits | None) -> None:
        """Apply limits set by an engineer; None restores those of the configuration."""
        self.drive.limits = own or self.config.limits

    def close(self) -> None:
        """Remove the drive from its bus; nothing is sent."""
        self.stop_monitor()
        self.drive.close()

    def stop_monitor(self) -> None:
        """End the polls; the state is unknown until ``start_monitor``. Idempotent."""
        if self.monitor is not None:
            self.monitor.close()
            self.monitor = None

    # --- samples ------------------------------------------------------------------------------------------------

    def new_samples(self, readings: Mapping[str, Reading], time_ms: int) -> list[Sample]:
        """Return a sample of each reading that had none yet, and one without value where a reading became bad."""
        found = (self._sample(name, reading, time_ms) for name, reading in readings.items())
        return [sample for sample in found if sample is not None]

    def end_samples(self, time_ms: int, *, but: Collection[str] = ()) -> list[Sample]:
        """Return a sample without value for each signal that is no longer read, other than ``but``."""
        ended = [name for name, mark in self._last_sampled.items() if mark is not None and name not in but]
        for name in ended:
            del self._last_sampled[name]
        return [Sample(f"{self.id}.{name}", time_ms, None, Quality.BAD) for name in ended]

    def _sample(self, name: str, reading: Reading, time_ms: int) -> Sample | None:
        if name not in self.signals or isinstance(reading.value, str):
            return None
        bad = reading.quality is Quality.BAD
        mark = None if bad else reading.source_time
        if (bad and name not in self._last_sampled) or self._last_sampled.get(name, _NOT_SAMPLED) == mark:
            return None
        self._last_sampled[name] = mark
        value = None if bad or reading.value is None else float(reading.value)
        return Sample(f"{self.id}.{name}", time_ms, value, reading.quality)


_NOT_SAMPLED: Any = object()
