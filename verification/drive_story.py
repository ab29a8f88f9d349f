"""Story that every drive plays: status, readings, run both ways, change of speed, trip, reset, stop, lost contact.

Each step compares what drivebus reports with what the motor of the station does. On a line that loses or
delays frames a step is repeated as a user would.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from drivebus.bus import Bus
from drivebus.drives import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import DrivebusError, StopUnconfirmed
from drivebus.profiles.model import DriveProfile
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import SimPort
from drivebus.simulator.station import SimulatedStation

LINES = ("clean", "bytes", "loss=0.03", "late=0.02:0.3")
"""Line qualities: whole frames, byte by byte, lossy, late."""
OPTIONS: dict[str, dict[str, Any]] = {
    "dzb100": {"query_coding": "hex-0.1", "setpoint_coding": "hex-0.1"},
    "df800": {"direction_calibrated": True},
}
"""Options that a calibration settles, as the simulated drives have them."""
HIDES_FAULTS = frozenset({"huanyang_hy", "huanyang_h2a", "huanyang_p2a", "df800"})
"""Models that report no fault: a tripped drive reads as stopped, or no state is read at all."""
TRIES = 20
RAMP_S = 2.0
SETTLE_S = 3.0
PHYSICAL_TOLERANCE = 0.02
"""Largest error of a reading, as a share of its value, beyond one step."""
PHYSICAL_SIGNALS: dict[str, Callable[[SimulatedStation], float]] = {
    "output_frequency": lambda station: abs(station.motor.output_hz),
    "output_current": lambda station: station.motor.current_a,
    "output_voltage": lambda station: station.motor.voltage_v,
    "dc_bus_voltage": lambda station: station.motor.bus_v,
    "output_speed": lambda station: abs(station.motor.speed_rpm),
    "temperature": lambda station: station.motor.temperature_c,
}
"""Signals whose value the station's motor states in the same unit."""


class StoryError(AssertionError):
    """A step whose outcome is not what the station did."""


async def play(profile: DriveProfile, station: SimulatedStation, line: str, seed: int = 1) -> list[str]:
    """Play the story on a line and return its steps. Raises StoryError."""
    station.set_ramps(RAMP_S, RAMP_S)
    simulated = SimulatedBus([station], station.factory_settings, line_quality=line, seed=seed)
    port: Any = SimPort(simulated, station.factory_settings, f"sim://{profile.model}", "off")
    share = profile.setpoint_share
    stated = share.maximum_hz if share is not None and share.maximum is None else None
    async with Bus(port) as bus:
        options = OPTIONS.get(profile.model, {}) | ({"maximum_frequency": int(stated)} if stated else {})
        drive = Drive(bus, profile, station.address, options=options)
        return await _Story(drive, station).steps()


class _Story:
    def __init__(self, drive: Drive, station: Any) -> None:
        self.drive = drive
        self.station = station
        self.able = drive.profile.capabilities
        self.known_state = "status" in self.able
        self.acknowledged = frozenset({OutcomeStatus.CONFIRMED, OutcomeStatus.ACKNOWLEDGED})
        self.wanted = frozenset({OutcomeStatus.CONFIRMED}) if self.known_state else self.acknowledged
        self.slow_hz = min(10.0, drive.profile.limits.maximum_hz / 2)  # some are capped until their unit is confirmed
        self.done: list[str] = []

    async def steps(self) -> list[str]:
        await self._status(DriveState.STOPPED)
        self.done.append("status")
        identity = await self._until_answered(self.drive.identify)
        if self.drive.profile.model not in identity.model.split(" / "):
            raise StoryError(f"identified as {identity.model}")
        self.done.append("identify")
        await self._write()
        await self._run(self.slow_hz, Direction.FORWARD)
        if "set_frequency" in self.able:
            await self._until_succeeded(lambda: self.drive.set_frequency(2 * self.slow_hz), self.acknowledged)
            await self._settle()
            self._expect_hz(2 * self.slow_hz, "set_frequency")
        await self._read()
        await self._stop()
        if "reverse" in self.able:
            await self._run(self.slow_hz, Direction.REVERSE)
            await self._stop()
        await self._fault()
        await self._lose_line()
        return self.done

    async def _run(self, hertz: float, direction: Direction) -> None:
        reverse = direction is Direction.REVERSE
        await self._until_succeeded(lambda: self.drive.run(hertz, direction if "reverse" in self.able else None))
        await self._settle()
        self._expect_hz(-hertz if reverse else hertz, f"run {direction.value}")

    async def _stop(self) -> None:
        await self._until_succeeded(self.drive.stop)
        await self._settle()
        if self.station.motor.energised:
            raise StoryError("stop succeeded, and the motor is energised")
        self.done.append("stop")

    async def _read(self) -> None:
        """Compare each reading that has a unit and a published step with the motor."""
        for name, signal in self.drive.profile.signals.items():
            truth = PHYSICAL_SIGNALS.get(name)
            if truth is None or not signal.unit or signal.uncertain:
                continue
            value, expected = await self._until_read(name), truth(self.station)
            if abs(value - expected) > signal.scale.factor + PHYSICAL_TOLERANCE * abs(expected):
                raise StoryError(f"{name} reads {value}, and the station has {expected:.2f}")
            self.done.append(f"read {name}")

    async def _write(self) -> None:
        """Write a parameter with the value that it holds, which no drive may find harmful."""
        profile = self.drive.profile
        roles = set(profile.roles.values())
        free = [
            parameter
            for parameter in profile.parameters.values()
            if parameter.writable and parameter.readable and parameter.notation not in roles
        ]
        if "write" not in self.able or not free:
            return
        name = free[0].notation
        value = await self._until_read(name)
        await self._until_succeeded(
            lambda: self.drive.write({name: value}, save="write_ram" not in self.able), self.acknowledged
        )
        if await self._until_read(name) != value:
            raise StoryError(f"{name} is not {value} after it was written")
        self.done.append("write")

    async def _fault(self) -> None:
        if not self.known_state or self.drive.profile.model in HIDES_FAULTS:
            return
        self.station.trip(Trip.OVERLOAD)
        await asyncio.sleep(1)
        status = await self._status(DriveState.FAULT)
        self.done.append("fault")
        described = self.drive.profile.status
        if described is not None and described.fault_registers:
            if status.fault is None or status.fault.code != self.station.trip_code(Trip.OVERLOAD):
                raise StoryError(f"the station trips with {self.station.trip_code(Trip.OVERLOAD)}, read {status.fault}")
            self.done.append("fault number")
        if "reset_fault" in self.able:
            await self._until_succeeded(self.drive.reset_fault)
            await self._status(DriveState.STOPPED)
            self.done.append("reset")
        else:
            self.station.motor.reset()

    async def _lose_line(self) -> None:
        """Lose all replies while the motor runs: no stop is reported as confirmed, and the next one after it is."""
        await self._run(self.slow_hz, Direction.FORWARD)
        self.station.faults.silent = True
        try:
            outcome = await self.drive.stop()
        except StopUnconfirmed:
            pass
        else:
            raise StoryError(f"a silent station, and the stop is {outcome.status}")
        if not self.station.motor.energised:
            raise StoryError("the silent station stopped by itself")
        self.station.faults.silent = False
        await asyncio.sleep(10)
        await self._stop()
        self.done.append("communication loss")

    async def _status(self, state: DriveState) -> Any:
        status = None
        for _ in range(TRIES):
            status = await self._until_answered(self.drive.status)
            if status.state is (state if self.known_state else DriveState.UNKNOWN):
                return status
            await asyncio.sleep(1)
        raise StoryError(f"the station is {state}, read {None if status is None else status.state}")

    def _expect_hz(self, hertz: float, step: str) -> None:
        if abs(self.station.motor.output_hz - hertz) > 0.1:
            raise StoryError(f"{step}: {hertz} Hz expected, {self.station.motor.output_hz:.2f} Hz at the motor")
        self.done.append(step)

    async def _settle(self) -> None:
        """Let the ramp end; the simulated drive computes its motor when time is given to it."""
        await asyncio.sleep(SETTLE_S)
        self.station.advance(asyncio.get_running_loop().time())

    async def _until_succeeded(
        self, action: Callable[[], Awaitable[Any]], wanted: frozenset[OutcomeStatus] | None = None
    ) -> None:
        """Repeat a command; where the drive reports its state, it must be confirmed."""
        reason = ""
        for _ in range(TRIES):
            try:
                outcome = await action()
            except DrivebusError as error:
                reason = str(error)
            else:
                if outcome.status in (wanted or self.wanted):
                    return
                reason = outcome.text()
            await asyncio.sleep(1)
        raise StoryError(f"not confirmed in {TRIES} tries: {reason}")

    async def _until_read(self, name: str) -> float:
        """Read a signal again until it has a value, as after a lost reply."""
        for _ in range(TRIES):
            reading = (await self._until_answered(lambda: self.drive.read([name])))[name]
            if reading.value is not None:
                return float(reading.value)
            await asyncio.sleep(1)
        raise StoryError(f"{name} not read in {TRIES} tries")

    async def _until_answered(self, action: Callable[[], Awaitable[Any]]) -> Any:
        reason = ""
        for _ in range(TRIES):
            try:
                return await action()
            except DrivebusError as error:
                reason = str(error)
            await asyncio.sleep(1)
        raise StoryError(f"not answered in {TRIES} tries: {reason}")
