"""Supervision cycle (4 Hz): sample every drive, publish views, evaluate interlocks and alarms, expire leases."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from drivebus import i18n
from drivebus.drives.state import DriveStatus
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import failure_reason, localized
from drivebus.service.audit.chain import AUDIT_FILE
from drivebus.service.config.certificates import CertificateState, certificate_states
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.control_commands import ControlCommands
from drivebus.service.control.jogs import RemoteJogs
from drivebus.service.control.policies import StopPolicies
from drivebus.service.incidents.service import IncidentService
from drivebus.service.live.publisher import LivePublisher
from drivebus.service.process.clock_sync import is_clock_synchronized
from drivebus.service.process.installed_files import changed_packages
from drivebus.service.process.permissions import certificate_problems
from drivebus.service.process.systemd import SystemdNotifier
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.comm_loss_reads import CommLossReads
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.drive_reports import report_fault, report_motion, report_other_speed, report_presence
from drivebus.service.runtime.failure_log import failure_logged
from drivebus.service.runtime.plant import Plant
from drivebus.service.runtime.run_statistics import DOCUMENT_KIND as RUN_STATISTICS
from drivebus.service.storage.storage import Storage
from drivebus.types import Json
from drivebus.values import bilingual_text

CYCLE_S = 0.25
STEPS_PER_TURN = 4  # steps without a pause: one or two milliseconds
BUS_VIEW_CYCLES = 4  # buses are published once a second
DISK_CHECK_CYCLES = 40  # free space, certificates and the state of the clock are read every ten seconds
CLOCK_SYNC_GRACE_S = 600.0  # after a start of the computer it takes minutes until its clock is synchronized
STORAGE_CHECK_CYCLES = 20  # files written in the background are checked every five seconds
Step = Callable[[], None]
LOG = logging.getLogger("drivebus.service")


class SupervisionCycle:
    """Supervision of a plant in steps, so that no bus waits for a whole cycle.

    A pause after every step would let 300 drives wait for 300 iterations of the loop, each with a part of a request.
    """

    def __init__(
        self,
        plant: Plant,
        publisher: LivePublisher,
        *,
        jogs: RemoteJogs,
        policies: StopPolicies,
        control: ControlCommands,
        storage: Storage,
        incidents: IncidentService,
        watchdog: SystemdNotifier | None,
    ) -> None:
        self._plant, self._publisher, self._jogs, self._policies = plant, publisher, jogs, policies
        self._control = control
        self._storage, self._incidents, self._watchdog = storage, incidents, watchdog
        self._cycles = 0
        self._disk_task: asyncio.Task[None] | None = None
        self._expiring = {
            alarm.subject for alarm in plant.alarms.active() if alarm.kind == SystemAlarm.CERTIFICATE_EXPIRY
        }
        self._reported_problems: set[str] = set()  # English sentences of problems that are no alarm
        self._clock_report_at = plant.now() + CLOCK_SYNC_GRACE_S
        self._software_problems: list[Json] | None = None  # read once: an update replaces the files meanwhile
        self._comm_loss_reads = CommLossReads(plant)

    async def run(self) -> None:
        """Run until cancelled. A step that fails is logged; the others go on, because a motor may be turning."""
        while True:
            due = self._plant.now() + CYCLE_S
            for number, step in enumerate(self._steps(), 1):
                self._run_step(step)
                if number % STEPS_PER_TURN == 0:
                    await asyncio.sleep(0)
            await asyncio.sleep(max(0.0, due - self._plant.now()))

    def run_once(self) -> None:
        """Run one cycle."""
        for step in self._steps():
            self._run_step(step)

    def _run_step(self, step: Step) -> None:
        with failure_logged():
            step()

    def _steps(self) -> Iterator[Step]:
        plant = self._plant
        plant.clock.follow_wall_clock()
        for runtime in tuple(plant.drives.values()):
            yield partial(self._supervise_drive, runtime)
        yield lambda: self._policies.enforce_interlocks(plant.views, plant.now())
        yield lambda: self._policies.expire_leases(plant.now())
        yield self._control.expire_requests
        yield self._jogs.expire
        for group in plant.config.groups:
            yield partial(self._publish_group, group)
        for bus_runtime in tuple(plant.buses.values()) if self._cycles % BUS_VIEW_CYCLES == 0 else ():
            yield partial(self._supervise_bus, bus_runtime)
        yield self._supervise_plant
        if self._cycles % STORAGE_CHECK_CYCLES == STORAGE_CHECK_CYCLES - 1:
            yield self._check_storage
        self._cycles += 1
        if self._watchdog is not None:
            yield partial(self._watchdog.feed_watchdog, plant.buses.values(), plant.now())

    async def _check_disk(self) -> None:
        """Read the clock, and in threads free space, certificates and installed files: no bus waits for a hung disk."""
        plant, config = self._plant, self._plant.config
        plant.clock_synchronized = is_clock_synchronized()
        plant.disk_space = await asyncio.to_thread(_disk_space, config.directory)
        certificates = await asyncio.to_thread(lambda: list(certificate_states(config)))
        self._report_certificates(certificates)
        errors = await asyncio.to_thread(lambda: list(certificate_problems(config)))
        if self._software_problems is None:
            changed = await asyncio.to_thread(lambda: list(changed_packages()))
            self._software_problems = [localized("plant.package_changed", found.text_params()) for found in changed]
        problems = [*self._software_problems, *(localized(error.key, error.params) for error in errors)]
        now = datetime.fromtimestamp(plant.wall_ms() / 1000, UTC)
        early = [state.begin_params for state in certificates if state.is_early(now)]
        problems += [localized("plant.certificate_early", params) for params in early]
        if plant.clock_synchronized is False and plant.now() >= self._clock_report_at:
            problems.append(localized("plant.clock_unsynchronized"))
        self._report_problems(problems)

    def _report_certificates(self, states: Sequence[CertificateState]) -> None:
        """Raise an alarm for each certificate that ends soon; clear those of renewed certificates and of others."""
        now = datetime.fromtimestamp(self._plant.wall_ms() / 1000, UTC)
        ending = {state.gateway: state for state in states if state.ends_soon(now)}
        for gateway in self._expiring - ending.keys():
            self._plant.clear_alarm(SystemAlarm.CERTIFICATE_EXPIRY, subject=gateway)
        self._expiring = set(ending)
        for gateway, state in ending.items():
            params = {"file": str(state.certificate), "until": f"{state.valid_until:%Y-%m-%d %H:%M} UTC"}
            self._plant.raise_alarm(SystemAlarm.CERTIFICATE_EXPIRY, subject=gateway, **params)

    def _report_problems(self, problems: Sequence[Json]) -> None:
        """Publish an event for each problem of the computer or its files, once until it is mended."""
        texts = {text["en"]: text for text in problems}
        for name in texts.keys() - self._reported_problems:
            LOG.warning(texts[name][i18n.preferred()])
            self._plant.publish_event_text("configuration", None, texts[name], None, None, log=False)
        self._reported_problems = set(texts)

    def _check_storage(self) -> None:
        """Raise an alarm for each file that is written in the background and fails; try it again."""
        for name, error in (self._storage.errors() | {"incidents": self._incidents.recorder.error}).items():
            kind = SystemAlarm.AUDIT_FAILURE if name == AUDIT_FILE else SystemAlarm.STORAGE_FAILURE
            if error is not None:
                self._plant.raise_alarm(kind, subject=name, reason=failure_reason(error))
            else:
                self._plant.clear_alarm(kind, subject=name)
        self._storage.alarm_log.retry()
        if self._storage.run_statistics.is_loaded:  # later than at the start where the database did not answer
            self._plant.report_damaged(RUN_STATISTICS, self._storage.run_statistics.damaged_copy)

    def _supervise_bus(self, bus_runtime: BusRuntime) -> None:
        if self._plant.buses.get(bus_runtime.config.id) is bus_runtime:
            self._supervise_port(bus_runtime)
            self._publisher.publish_bus(bus_runtime)

    def _publish_group(self, group: GroupConfig) -> None:
        if group in self._plant.config.groups:
            self._publisher.publish_group(group)

    def _supervise_plant(self) -> None:
        plant = self._plant
        if self._cycles % DISK_CHECK_CYCLES == 0 and (self._disk_task is None or self._disk_task.done()):
            self._disk_task = asyncio.create_task(self._check_disk(), name="disk space")
        if plant.historian.ok:
            plant.clear_alarm(SystemAlarm.STORAGE_FAILURE, subject="history")
        else:
            plant.raise_alarm(SystemAlarm.STORAGE_FAILURE, subject="history", reason=plant.historian.problem)
        plant.publish_alarms(plant.alarms.expire_shelves(plant.now()))
        self._publisher.publish_plant()

    def _supervise_drive(self, runtime: DriveRuntime) -> None:
        if self._plant.drives.get(runtime.id) is not runtime:
            return
        plant = self._plant
        plant.views.pop(runtime.id, None)  # where no new one can be made, interlocks must not go on with the old one
        status = runtime.status()
        view = self._publisher.publish_drive(runtime, status)
        for step in (
            lambda: plant.put_view(view),
            lambda: report_presence(plant, runtime, status),
            lambda: report_fault(plant, runtime, status),
            lambda: self._follow_motion(runtime, status),
            lambda: report_other_speed(plant, runtime, status),
            lambda: self._report_lost_port(runtime),  # before the alarms of the drive, which it suppresses
            lambda: plant.publish_alarms(plant.alarms.observe(view, plant.now(), plant.wall_ms())),
            lambda: self._comm_loss_reads.schedule(runtime),
        ):
            self._run_step(step)

    def _follow_motion(self, runtime: DriveRuntime, status: DriveStatus) -> None:
        self._policies.apply_on_restart(runtime, status)  # before its first report is noted
        report_motion(self._plant, runtime, status)

    def _report_lost_port(self, runtime: DriveRuntime) -> None:
        bus_runtime = self._plant.bus_of(runtime)
        if not runtime.bus.is_open and bus_runtime.reported_open is not False:
            self._supervise_port(bus_runtime)

    def _supervise_port(self, bus_runtime: BusRuntime) -> None:
        """Raise alarms for a lost port and a foreign master; publish an event when a port is lost or open again."""
        bus, plant = bus_runtime.config.id, self._plant
        title = bus_runtime.title
        is_open, reported_open = bus_runtime.bus.is_open, bus_runtime.reported_open
        if is_open:
            bus_runtime.reported_open = True
            plant.clear_alarm(SystemAlarm.PORT_LOST, subject=bus)
            if reported_open is False:
                plant.publish_event("presence", None, "plant.bus_open", bus=title)
        elif bus_runtime.has_opened or bus_runtime.problem is not None:
            bus_runtime.reported_open = False
            reason = bus_runtime.problem or bilingual_text("plant.bus_reopened")
            plant.raise_alarm(SystemAlarm.PORT_LOST, subject=bus, bus=title, reason=reason)
            if reported_open is not False and bus_runtime.has_opened:
                plant.publish_event("presence", None, "plant.bus_lost", bus=title)
        if is_open and bus_runtime.bus.foreign_master:
            plant.raise_alarm(SystemAlarm.FOREIGN_MASTER, subject=bus, bus=title)
        else:
            plant.clear_alarm(SystemAlarm.FOREIGN_MASTER, subject=bus)

    async def close(self) -> None:
        """Cancel the reads that are under way."""
        await self._comm_loss_reads.close()
        if self._disk_task is not None:
            self._disk_task.cancel()
            await asyncio.gather(self._disk_task, return_exceptions=True)


def _disk_space(directory: Path) -> Json:
    with suppress(OSError):
        usage = shutil.disk_usage(directory)
        return {"free_mb": usage.free // 2**20, "total_mb": usage.total // 2**20}
    return {}
