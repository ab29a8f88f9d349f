"""Group commands: sequenced starts, and frequencies of followers at their ratio to the leader.

The leader starts first; where it does not start, no follower does.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from math import ceil, floor, inf

from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import DriveState
from drivebus.errors import (
    ControlNotHeld,
    DrivebusError,
    Expired,
    Interlocked,
    LimitError,
    ServiceError,
    StartInhibited,
    Superseded,
)
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.groups import (
    GROUP_ARM,
    GROUP_SET_FREQUENCY,
    GROUP_START,
    GroupParams,
    GroupSetFrequencyParams,
    GroupStartParams,
)
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.drive_commands import DriveCommands, follower_hz
from drivebus.service.control.leases import ARM_TTL_S, arm_target_of_group
from drivebus.service.control.start_blockers import check_start
from drivebus.service.control.tickets import CommandTicket, check_not_superseded
from drivebus.service.live.views import text_json
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

SLOT_POLL_INTERVAL_S = 0.1
RANGE_ERRORS = ("drives.above_maximum", "drives.below_minimum")
"""Errors of a frequency outside ``Drive.range_hz``; the error of ``Drive.setpoint_cap_hz`` explains itself."""
ACCELERATING_STATES = (DriveState.ACCELERATING, DriveState.RESTARTING)
DEFAULT_RAMP_S = 10.0
"""A drive that does not report its state counts as accelerating for its ramp time, or this long where unknown."""


@dataclass(frozen=True, slots=True)
class _GroupStart:
    """Start of a group that is under way; its leader is the first drive."""

    group: GroupConfig
    runtimes: list[DriveRuntime]
    params: GroupStartParams
    actor: Actor


class GroupCommands:
    """Starts and setpoints of groups."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands
        self.progress: dict[str, int] = {}
        """Group that is being started → number of drives started so far."""

    def _require_control(self, id: str, actor: Actor) -> tuple[GroupConfig, list[DriveRuntime]]:
        """Return the drives of a group, the leader first. Raises NotFound, ControlNotHeld."""
        group = self.plant.group(id)
        order = sorted(group.drives, key=lambda drive: drive != group.leader)
        return group, [self.commands.require_control(drive, actor) for drive in order]

    @handles(GROUP_ARM)
    async def arm_start(self, params: GroupParams, actor: Actor) -> Json:
        """Issue the token of a start. Fails for every reason for which the start itself would."""
        group, runtimes = self._require_control(params.group, actor)
        self._check_may_start(group, runtimes)
        return {
            "arm_token": self.plant.arm_tokens.issue(arm_target_of_group(group.id), actor, self.plant.now()),
            "expires_s": ARM_TTL_S,
        }

    def _check_may_start(self, group: GroupConfig, runtimes: list[DriveRuntime]) -> None:
        """Check what forbids the start of a group at any frequency. Raises the error of the first check that fails."""
        for runtime in runtimes:
            check_start(self.plant, runtime)
        _check_none_tripped(group, runtimes)
        _check_followers_online(group, runtimes)

    @handles(GROUP_START)
    async def start(self, params: GroupStartParams, actor: Actor, ticket: CommandTicket) -> Json:
        """Start the drives one after another; nothing is sent unless every one may start at its frequency.

        A stop of any drive, or a leader that has not started, ends the sequence. Raises Expired (TargetNotReached,
        where its frequency was sent) for the first drive: then no other is tried.
        """
        group, runtimes = self._require_control(params.group, actor)
        if group.id in self.progress:
            raise Superseded("plant.group_starting", group=group.id)
        self._check_may_start(group, runtimes)
        for runtime in runtimes:
            _check_member_frequency(group, runtime, params.frequency_hz)
        self.plant.arm_tokens.consume(params.arm_token, arm_target_of_group(group.id), actor, self.plant.now())
        self.progress[group.id] = 0
        start = _GroupStart(group, runtimes, params, actor)
        outcomes: Json = {}
        try:
            for runtime in runtimes:
                outcomes[runtime.id] = await self._start_one(start, runtime, ticket)
                if runtime.id == group.leader and not _is_done(outcomes[runtime.id]):
                    return {"outcomes": outcomes | _skipped(group, runtimes[1:])}
                self.progress[group.id] += 1
                ticket = replace(ticket, issued_at=self.plant.now())  # the next drive has a start deadline of its own
        finally:
            self.progress.pop(group.id, None)
        return {"outcomes": outcomes}

    async def _start_one(self, start: _GroupStart, runtime: DriveRuntime, ticket: CommandTicket) -> Json:
        """Start one drive when it is its turn, unless a drive of the group was stopped meanwhile."""
        params, actor = start.params, start.actor
        try:
            requested_at = await self._wait_for_slot(start, runtime, ticket)
            self._check_not_superseded(start.group, ticket)
            self._check_still_owner(runtime, actor)
            check_start(self.plant, runtime)
            if any(other.id not in self.plant.drives for other in start.runtimes):
                raise Superseded("plant.another_meanwhile", drive=runtime.id)
            frequency_hz = follower_hz(start.group, runtime.id, params.frequency_hz)
            started = await self.commands.start_drive(runtime, frequency_hz, params.direction, actor, requested_at)
        except DrivebusError as error:
            if runtime is start.runtimes[0] and _is_expired(error):
                raise  # the command has expired for every drive
            return error_to_json(error)
        runtime.group_started_at = self.plant.now()
        outcome: Json = started["outcome"]
        return outcome

    def _check_not_superseded(self, group: GroupConfig, ticket: CommandTicket) -> None:
        """Raise Superseded after a stop of one of its drives, or a reload that changed one of them or the group."""
        check_not_superseded(self.plant, ticket)
        if group not in self.plant.config.groups:
            raise Superseded("plant.another_group_meanwhile", group=group.id)

    def _check_still_owner(self, runtime: DriveRuntime, actor: Actor) -> None:
        """Raise ControlNotHeld where the actor lost control while other drives started."""
        if not self.plant.leases.controls(runtime.id, actor, self.plant.now()):
            raise ControlNotHeld("plant.lease_gone", drive=runtime.id)

    async def _wait_for_slot(self, start: _GroupStart, runtime: DriveRuntime, ticket: CommandTicket) -> float:
        """Wait for the drive's turn; return the time from which its start deadline runs.

        Raises Superseded, and ControlNotHeld where the session that starts the group no longer controls the drive.
        """
        requested_at = ticket.issued_at
        while not self._is_slot_free(start, runtime):
            self._poll_accelerating(start.runtimes)
            await asyncio.sleep(SLOT_POLL_INTERVAL_S)
            requested_at = self.plant.now()
            check_not_superseded(self.plant, ticket)
            self._check_still_owner(runtime, start.actor)
        return requested_at

    def _poll_accelerating(self, runtimes: list[DriveRuntime]) -> None:
        """Poll the state of the drives that the others wait for: its turn may be many seconds away."""
        for runtime in runtimes:
            if runtime.monitor is not None and self._is_accelerating(runtime, self.plant.now()):
                runtime.monitor.poll_state()

    def _is_slot_free(self, start: _GroupStart, runtime: DriveRuntime) -> bool:
        """Return whether the next drive may start: the last start is long enough ago, and few enough accelerate."""
        now, group = self.plant.now(), start.group
        starts = [other.group_started_at for other in start.runtimes if other.started_by_service]
        last = max((at for at in starts if at is not None), default=-inf)
        busy = sum(1 for other in start.runtimes if other is not runtime and self._is_accelerating(other, now))
        return now - last >= group.start_interval_s and busy < group.max_concurrent_starts

    def _is_accelerating(self, runtime: DriveRuntime, now: float) -> bool:
        if runtime.group_started_at is None or not runtime.started_by_service:
            return False
        status = runtime.status()
        if status.state is DriveState.UNKNOWN:
            ramp_s = runtime.drive.acceleration_s
            return now - runtime.group_started_at < (DEFAULT_RAMP_S if ramp_s is None else ramp_s)
        fresh = status.at is not None and status.at >= runtime.group_started_at
        return not fresh or status.state in ACCELERATING_STATES

    @handles(GROUP_SET_FREQUENCY)
    async def set_frequency(self, params: GroupSetFrequencyParams, actor: Actor, ticket: CommandTicket) -> Json:
        """Set the leader's frequency (of every drive where there is no leader), then the followers' at their ratio.

        The age of a follower's setpoint counts from the leader's outcome.
        """
        group, runtimes = self._require_control(params.group, actor)
        for runtime in runtimes:
            _check_member_frequency(group, runtime, params.frequency_hz)
        first = runtimes[:1] if group.leader else []
        outcomes = {
            runtime.id: await self.commands.set_drive_frequency(
                runtime, follower_hz(group, runtime.id, params.frequency_hz), actor, ticket.issued_at
            )
            for runtime in first
        }
        rest = runtimes[len(first) :]
        if not all(map(_is_done, outcomes.values())):
            return {"outcomes": outcomes | _skipped(group, rest)}
        if first:
            ticket = replace(ticket, issued_at=self.plant.now())
        rest_outcomes = await asyncio.gather(
            *(self._set_follower_unless_stopped(group, runtime, params.frequency_hz, actor, ticket) for runtime in rest)
        )
        rest_ids = [runtime.id for runtime in rest]
        return {"outcomes": outcomes | dict(zip(rest_ids, rest_outcomes, strict=True))}

    async def _set_follower_unless_stopped(
        self, group: GroupConfig, runtime: DriveRuntime, frequency_hz: float, actor: Actor, ticket: CommandTicket
    ) -> Json:
        """Set a follower's frequency unless a drive was stopped while the leader got its own."""
        try:
            self._check_not_superseded(group, ticket)
        except Superseded as error:
            return error_to_json(error)
        return await self.commands.set_follower(group, runtime, frequency_hz, actor, ticket.issued_at)

    def group_view(self, group: GroupConfig) -> Json:
        """Return the live topic ``groups/<id>``."""
        started = self.progress.get(group.id)
        progress = None if started is None else {"started": started, "of": len(group.drives)}
        state = "starting" if progress else self._group_state(group)
        ranges_hz = [_group_range_hz(group, runtime) for runtime in self._present_drives(group)]
        return {
            "id": group.id,
            "title": text_json(group.title),
            "drives": list(group.drives),
            "leader": group.leader,
            "ratios": dict(group.ratios),
            "minimum_hz": max((low for low, _ in ranges_hz), default=0.0),
            "maximum_hz": min((high for _, high in ranges_hz), default=0.0),
            "state": state,
            "progress": progress,
        }

    def _present_drives(self, group: GroupConfig) -> list[DriveRuntime]:
        """Return the drives of a group that the plant has now: during a reload some may be missing."""
        return [self.plant.drives[id] for id in group.drives if id in self.plant.drives]

    def _group_state(self, group: GroupConfig) -> str:
        runtimes = self._present_drives(group)
        if any(runtime.state_is_unknown or not runtime.is_online for runtime in runtimes):
            return "unknown"
        turning = [runtime.turning for runtime in runtimes]
        return "running" if all(turning) else "mixed" if any(turning) else "stopped"


def _check_followers_online(group: GroupConfig, runtimes: list[DriveRuntime]) -> None:
    """Check that every follower of a leader replies: without one the leader would run alone.

    A leader without reply does not start, and then no follower does. Raises Interlocked.
    """
    for runtime in runtimes[1:] if group.leader else ():
        if not runtime.is_online:
            raise Interlocked("plant.member_offline", drive=runtime.id, group=group.id, leader=group.leader)


def _check_none_tripped(group: GroupConfig, runtimes: list[DriveRuntime]) -> None:
    """Check that no drive of the group reports a fault: the others would run without it. Raises StartInhibited."""
    for runtime in runtimes:
        if runtime.status().state is DriveState.FAULT:
            raise StartInhibited("plant.member_fault", drive=runtime.id, group=group.id)


def _check_member_frequency(group: GroupConfig, runtime: DriveRuntime, frequency_hz: float) -> None:
    """Check the frequency of a member at its ratio.

    Raises LimitError with the member, and for a frequency outside its range with those that the group may have.
    """
    own_hz = follower_hz(group, runtime.id, frequency_hz)
    try:
        runtime.drive.check_frequency(own_hz)
    except LimitError as error:
        if error.key not in RANGE_ERRORS:
            raise LimitError("plant.member_limit", drive=runtime.id, group=group.id, why=error) from error
        low_hz, high_hz = _group_range_hz(group, runtime)
        raise LimitError(
            "plant.group_frequency",
            drive=runtime.id,
            group=group.id,
            frequency_hz=own_hz,
            ratio=group.ratios.get(runtime.id, 1.0),
            low_hz=low_hz,
            high_hz=high_hz,
            why=error,
        ) from error


def _group_range_hz(group: GroupConfig, runtime: DriveRuntime) -> tuple[float, float]:
    """Return the lowest and highest frequency of the group, in hundredths of hertz, that a member permits."""
    ratio = group.ratios.get(runtime.id, 1.0)
    low_hz, high_hz = runtime.drive.range_hz
    cap_hz = runtime.drive.setpoint_cap_hz
    high_hz = high_hz if cap_hz is None else min(high_hz, cap_hz)
    return ceil(round(low_hz / ratio * 100, 6)) / 100, floor(round(high_hz / ratio * 100, 6)) / 100


def _is_expired(error: DrivebusError) -> bool:
    """Return whether a start was not sent because it had expired, also where its frequency had been sent."""
    return isinstance(error, Expired) or isinstance(error.params.get("why"), Expired)


def _is_done(outcome: Json) -> bool:
    return outcome.get("status") in (OutcomeStatus.CONFIRMED, OutcomeStatus.ACKNOWLEDGED)


def _skipped(group: GroupConfig, runtimes: list[DriveRuntime]) -> Json:
    """Return the errors of the followers of a leader that failed."""
    return {
        runtime.id: error_to_json(ServiceError("plant.leader_not_done", drive=runtime.id, leader=group.leader))
        for runtime in runtimes
    }
