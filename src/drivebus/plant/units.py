"""One drive of the plant: the drive itself, its monitor, and what the plant knows of it besides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from drivebus.bus import Bus
from drivebus.drives import Drive, DriveState, DriveStatus
from drivebus.drives.commloss import CommLossReport
from drivebus.drives.memory import DriveLimits
from drivebus.drives.monitor import Monitor
from drivebus.drives.statusread import complete
from drivebus.plant.config.polling import names_of, polls_of, profile_of
from drivebus.plant.failure import both
from drivebus.plant.model import DriveSetting
from drivebus.plant.view import HostDies, Sample
from drivebus.plant.waivers import Waiver
from drivebus.profiles.model import Text
from drivebus.reading import Quality, Reading
from drivebus.seams import Store

NOT_READ = Text(**both("plant.host_dies_not_read"))


class Unit:
    """A drive of the plant. ``samples`` is called with every new reading and once with each gap."""

    def __init__(
        self, setting: DriveSetting, bus: Bus, samples: Callable[[list[Sample]], None], store: Store | None = None
    ) -> None:
        self.setting, self.bus = setting, bus
        self.id = setting.id
        self.profile = profile_of(setting)
        self.signals = names_of(setting, self.profile)
        """Those that are polled: the ones that the plant's file names, else every one of the model."""
        self.drive = Drive(
            bus, self.profile, setting.address,
            encoding=setting.encoding, limits=setting.limits, settings=setting.settings, store=store,
        )  # fmt: skip
        self.polls = polls_of(setting, self.drive.dialect)
        self.monitor: Monitor | None = None
        self.host_dies = HostDies("unknown", None, NOT_READ)
        self.host_dies_read_at: float | None = None
        self.badge_stale = False
        self.badge_doubts = 0
        """Something was written since it was read."""
        self.started_at: float | None = None
        """When a group last started it."""
        self.waiver: str | None = None
        self.waiver_of_another: Waiver | None = None
        """Recorded under this name for another drive: it allows nothing."""
        self.commanded_hz: float | None = None
        self.started = False
        """This service started it and has not seen it stopped since."""
        self.moved_at = 0.0
        """When its last start was done; while one goes on, never."""
        self.judged = False
        """Its state has been known at least once since this service began."""
        self.wall_ms: Callable[[], int] = lambda: 0
        self._samples = samples
        self._fed: dict[str, float | None] = {}

    @property
    def badge(self) -> HostDies:
        """What the drive does when this host dies, with the waiver that somebody recorded."""
        found = HostDies("unknown", None, NOT_READ) if self.badge_stale else self.host_dies
        return replace(found, waiver=self.waiver)

    def take(self, setting: DriveSetting, *, polls: bool) -> None:
        """Other limits and policies from now on, and other ``polls``; everything else of the drive is as it was."""
        self.setting = setting
        if polls:
            self.profile, watched = profile_of(setting), self.monitor is not None
            self.signals = names_of(setting, self.profile)
            self.drive.repace(self.profile)
            self.polls = polls_of(setting, self.drive.dialect)
            self._unwatch()
            if watched:
                self.watch()

    def watch(self) -> None:
        """Begin to poll; the bus is open, so that what was proved on this port before is known."""
        self.monitor = self.monitor or self.drive.monitor(self.signals, self._heard, self.setting.fastest_s)

    def status(self) -> DriveStatus:
        """The newest, with old readings marked bad and an old state unknown."""
        if self.monitor is not None:
            return self.monitor.status()
        return complete(self.drive.dialect, DriveStatus(DriveState.UNKNOWN, reason="drives.not_read"), self.signals)

    @property
    def file_range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that the profile and the plant's file allow."""
        model, file = self.profile.limits, self.setting.limits
        highest = model.maximum_hz if file.maximum_hz is None else min(model.maximum_hz, file.maximum_hz)
        return max(model.minimum_hz, file.minimum_hz), highest

    def limit(self, own: DriveLimits | None) -> None:
        """Limits of an engineer on top of those of the plant's file, or only those (None)."""
        self.drive.limits = own or self.setting.limits

    def doubt_badge(self) -> None:
        """Something was written, or the drive was away: what it does when this host dies is not known until read."""
        self.badge_stale = True
        self.badge_doubts += 1

    def found_host_dies(self, report: CommLossReport, now: float, doubts: int | None = None) -> None:
        """What the drive was read to do when nobody speaks to it any more; ``doubts`` there were before it was read."""
        self.badge_stale = doubts is not None and doubts != self.badge_doubts
        kind = {True: "trips", False: "runs_on", None: "unknown"}[report.trips]
        self.host_dies = HostDies(kind, _seconds(report.time), Text(report.text("en"), report.text("zh")))
        self.host_dies_read_at = now

    def close(self) -> None:
        """Off its bus; nothing is sent."""
        self._unwatch()
        self.drive.close()

    def _unwatch(self) -> None:
        if self.monitor is not None:
            self.monitor.close()
            self.monitor = None

    # --- samples ------------------------------------------------------------------------------------------------

    def _heard(self, status: DriveStatus) -> None:
        self.feed(status.readings)

    def feed(self, readings: Mapping[str, Reading]) -> None:
        """Every reading once, and every gap once: bad values are no values (G17)."""
        time_ms = self.wall_ms()
        found = [sample for name in readings if (sample := self._sample(name, readings[name], time_ms)) is not None]
        if found:
            self._samples(found)

    def _sample(self, name: str, reading: Reading, time_ms: int) -> Sample | None:
        if name not in self.signals or isinstance(reading.value, str):
            return None
        bad = reading.quality is Quality.BAD
        mark = None if bad else reading.source_time
        if (bad and name not in self._fed) or self._fed.get(name, _NEVER) == mark:
            return None
        self._fed[name] = mark
        value = None if bad or reading.value is None else float(reading.value)
        return Sample(f"{self.id}.{name}", time_ms, value, reading.quality)


_NEVER: Any = object()


def _seconds(reading: Reading | None) -> float | None:
    if reading is None or reading.unit != "s" or not isinstance(reading.value, int | float):
        return None
    return float(reading.value)
