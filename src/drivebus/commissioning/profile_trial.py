"""Trial of a new profile on the simulated drive that is made of it: every command once, with its frames.

It shows that the profile is whole and that its parts fit. It is no evidence that the profile is right.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.trace import TraceEvent
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import Direction
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.modbus import Diagnostics
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import SimPort

TRIAL_HZ = 10.0
RAMP_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialStep:
    """Command of the trial. ``error`` is None where it succeeded."""

    name: str
    hz: float
    error: Outcome | DrivebusError | None
    frames: tuple[TraceEvent, ...]


async def try_profile(profile: DriveProfile) -> list[TrialStep]:
    """Run the commands that the profile is able to, until one fails; returns all steps tried."""
    address = max(1, profile.addresses[0])
    station = ProfileStation(address, profile=profile)
    station.set_ramps(RAMP_S, RAMP_S)
    simulated = SimulatedBus([station])
    share = profile.setpoint_share
    maximum_hz = None if share is None else share.maximum_hz
    options = None if maximum_hz is None else {"maximum_frequency": round(maximum_hz)}
    steps: list[TrialStep] = []
    frames: list[TraceEvent] = []

    port: Any = SimPort(simulated, simulated.settings, "sim://trial", "off")
    async with Bus(port) as bus:
        bus.trace(frames.append)
        drive = Drive(bus, profile, address, options=options)
        slow_hz = min(TRIAL_HZ, profile.limits.maximum_hz / 2)

        async def step(name: str, action: Callable[[], Awaitable[object]], hz: float = 0.0) -> bool:
            frames.clear()
            error: Outcome | DrivebusError | None = None
            try:
                result = await action()
                if isinstance(result, Outcome) and not result.succeeded:
                    error = result
            except DrivebusError as failure:
                error = failure
            steps.append(TrialStep(name=name, hz=hz, error=error, frames=_distinct(frames)))
            await asyncio.sleep(3 * RAMP_S)
            return error is None

        async def reset() -> object:
            station.trip(Trip.OVERLOAD)
            await asyncio.sleep(RAMP_S)
            await drive.status()
            return await drive.reset_fault()

        able = profile.capabilities
        plan: list[tuple[str, Callable[[], Awaitable[object]], float, bool]] = [
            ("status", drive.status, 0.0, "status" in able),
            ("start", lambda: drive.run(slow_hz), slow_hz, True),
            ("setpoint", lambda: drive.set_frequency(2 * slow_hz), 2 * slow_hz, True),
            ("stop", drive.stop, 0.0, True),
            ("reverse", lambda: drive.run(slow_hz, Direction.REVERSE), slow_hz, "reverse" in able),
            ("stop", drive.stop, 0.0, "reverse" in able),
            ("reset", reset, 0.0, {"reset_fault", "status"} <= able),
        ]
        for name, action, hz, is_able in plan:
            if is_able and not await step(name, action, hz):
                break
    return steps


def _distinct(frames: Sequence[TraceEvent]) -> tuple[TraceEvent, ...]:
    """Return the frames without sync probes, and each of the others once."""
    probes = {frame.data for frame in frames if isinstance(frame.message, Diagnostics)}
    events: dict[tuple[str, bytes], TraceEvent] = {}
    for frame in frames:
        if frame.data and frame.data not in probes:
            events.setdefault((frame.direction, frame.data), frame)
    return tuple(events.values())
