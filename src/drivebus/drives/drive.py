"""``Drive``: one drive of any protocol family on a bus."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus, Presence
from drivebus.bus.messages import BusResult
from drivebus.clock import random_word
from drivebus.drives.calibration import Calibration
from drivebus.drives.context import DriveContext, DriveLimits, Preflight
from drivebus.drives.dialects.base import DEFAULT_NONCE_START, Dialect, Identity, StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.jog_session import JogSession
from drivebus.drives.monitor import Monitor
from drivebus.drives.operations import hold, loopback, parameters, reset, setpoint, start, status
from drivebus.drives.operations import preflight as preflights
from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.jog import MAX_JOG_LEASE_S
from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.drives.operations.start import wait_at_speed
from drivebus.drives.operations.status import CommLossReport
from drivebus.drives.outcome import FrameExchange, Outcome, raise_for_status
from drivebus.drives.runner import OperationRunner
from drivebus.drives.state import Direction, DriveStatus
from drivebus.drives.stop_supervisor import JointStops, StopSupervisor
from drivebus.drives.store import FileStore, MemoryStore, Store, default_path, drive_key, value_if_readable
from drivebus.errors import Superseded
from drivebus.ports.base import Port, drive_options
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import StationTiming
from drivebus.values import Reading

VOLATILE_SCHEMES = ("sim", "memory", "replay")  # port URLs of drives without an EEPROM that wears


def known_options(port: Port, profile: DriveProfile, address: int) -> dict[str, Any]:
    """Return the profile options that the port itself has for the drive at an address (simulated drives)."""
    return {name: value for name, value in drive_options(port, address).items() if name in profile.options}


class Drive:
    """Control and monitor one drive.

    A command returns its Outcome where it is confirmed or acknowledged, and raises otherwise, with the outcome on the
    error and whether the motor may be running by it. Before anything was sent: CapabilityError, LimitError,
    PreflightError, StartInhibited, EepromBudgetExceeded, Expired; after that: DriveRejected, TargetNotReached,
    OutcomeUnknown, StopUnconfirmed, Superseded.
    """

    def __init__(
        self,
        bus: Bus,
        profile: DriveProfile | str | Path,
        address: int,
        *,
        encoding: str | None = None,
        limits: DriveLimits | None = None,
        options: Mapping[str, Any] | None = None,
        store: Store | None = None,
        timing: StationTiming | None = None,
        nonce_start: int | None = None,
        on_repeated_stop: Callable[[Outcome], None] = lambda outcome: None,
    ) -> None:
        """Register the drive on the bus. Raises ProfileError, ConfigurationError (address, encoding, option).

        ``nonce_start``: first number of the loop-backs that serve as sync probes, 0 to 65535; None: random, so that a
        late reply to a process before this one fits none of them, or fixed at a simulated port, so that runs repeat.
        ``on_repeated_stop`` is called with the outcome of a stop that was confirmed only when it was repeated.
        """
        loaded = profile if isinstance(profile, DriveProfile) else profiles.load(profile)
        self.bus, self.profile, self.address = bus, loaded, address
        self._store = store if store is not None else _store_for(bus)
        self.dialect: Dialect = create_dialect(
            loaded,
            address,
            encoding=encoding,
            options=known_options(bus.port, loaded, address) | dict(options or {}),
            timing=timing,
            nonce_start=_nonce_start_for(bus) if nonce_start is None else nonce_start,
        )
        limits = limits or DriveLimits()
        self._context = DriveContext(
            dialect=self.dialect, eeprom_budget=self._eeprom_budget(limits), limits=limits, on_read=self._publish_read
        )
        self._runner = OperationRunner(bus, self._context, self._store, self._load_stored)
        self._stops = StopSupervisor(self._runner, on_repeated_stop)
        self._calibration = Calibration(self._runner, self._stops, self._store, frozenset(options or ()))
        self._read_listeners: list[Callable[[BusResult], None]] = []
        self._last_published: BusResult | None = None
        self._stored_loaded = False
        self._load_stored()
        bus.add_station(self.dialect.station_config)

    def close(self) -> None:
        """Remove the drive from its bus; nothing is sent."""
        self._stops.cancel_repetition()
        self.bus.remove_station(self.address)

    def _eeprom_budget(self, limits: DriveLimits) -> EepromBudget:
        return EepromBudget(self._store, drive_key(self.bus.port.identity, self.address), limits.eeprom_writes_per_day)

    def _load_stored(self) -> None:
        """Load calibration and EEPROM counters once the port is open: only then its identity is known.

        Before that, ``/dev/ttyUSB0`` is a name that the adapter of another bus may have had.
        """
        if not self._stored_loaded and not self.bus.is_closed:
            self._stored_loaded = True
            self._context.eeprom_budget = self._eeprom_budget(self._context.limits)
            self._calibration.load()
            if self.dialect.model_check() is not None:
                key = f"model/{drive_key(self.bus.port.identity, self.address)}"
                self._context.model_key = key
                self._context.was_this_model = value_if_readable(self._store, key) == self.profile.model

    def _read_context(self) -> OperationContext:
        """Return the context of an operation that sends no motion command of its own."""
        return OperationContext(self._context)

    @property
    def limits(self) -> DriveLimits:
        """The user's own limits; a new value holds from the next command on."""
        return self._context.limits

    @limits.setter
    def limits(self, limits: DriveLimits) -> None:
        self._context.limits = limits
        self._context.eeprom_budget = self._eeprom_budget(limits)

    @property
    def range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be set, by the limits of the profile and of the user together."""
        return self._context.minimum_hz, self._context.maximum_hz

    @property
    def setpoint_cap_hz(self) -> float | None:
        """Highest frequency that is sent while the scale of the setpoint is not determined; None: no cap holds."""
        return self.dialect.setpoint_cap_hz

    @property
    def acceleration_s(self) -> float | None:
        """Acceleration ramp in seconds, None until the pre-flight check has read it."""
        return self._context.acceleration_s

    def set_poll_periods(self, profile: DriveProfile) -> None:
        """Use the poll periods of another profile of the same model, from the next monitor on."""
        self.profile = self.dialect.profile = profile

    def check_frequency(self, frequency_hz: float) -> float:
        """Return a frequency as the drive would round it, in Hz. Raises LimitError; nothing is sent."""
        return self._context.check_frequency(frequency_hz)[1]

    async def status(self, signals: Iterable[str] | None = None) -> DriveStatus:
        """Read state, direction, fault and signals now. Raises the error of the bus where the drive does not answer."""
        names = None if signals is None else tuple(signals)
        return await self._runner.run(status.read_status(self._read_context(), names))

    def monitor(
        self,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        period_s: float = 0.0,
    ) -> Monitor:
        """Poll these signals (None: all of the profile) until closed; ``on_change`` gets the status after each poll.

        It is also called after a poll without a reply, and after a read by a command. ``period_s`` is the shortest
        period of any poll, for a bus with more drives than the profile's periods allow; readings are then valid for
        three of these periods.
        """
        self._load_stored()
        return Monitor(
            self.bus, self.dialect, signals, on_change, period_s=period_s, read_listeners=self._read_listeners
        )

    def _publish_read(self, result: BusResult) -> None:
        """Pass a read to the monitors one turn of the event loop later, so that none can delay or break a command.

        Concurrent stops that share a read pass it once.
        """
        if result is self._last_published:
            return
        self._last_published = result
        for listener in self._read_listeners:
            asyncio.get_running_loop().call_soon(listener, result)

    async def identify(self) -> Identity:
        """Read the identity that the drive reports; of a model that reports none only that it answers."""
        return await self._runner.run(status.identify(self._read_context()))

    async def loopback_test(self, count: int = 10, is_cancelled: Callable[[], bool] | None = None) -> LoopbackReport:
        """Send requests that the drive returns unchanged. Raises CapabilityError where the model has no loop-back.

        The test ends with the results so far once ``is_cancelled`` returns True.
        """
        return await self._runner.run(loopback.loopback_test(self._read_context(), count, is_cancelled))

    async def preflight(self) -> Preflight:
        """Read whether the drive accepts commands from the bus; unmet preconditions are in the result."""
        return await self._runner.run(preflights.read_preflight(self._read_context()))

    async def comm_loss_behaviour(self) -> CommLossReport:
        """Read what the drive does when communication is lost."""
        return await self._runner.run(status.comm_loss_behaviour(self._read_context()))

    async def run(
        self,
        frequency_hz: float,
        direction: Direction | str | None = None,
        *,
        wait: bool = False,
        timeout_s: float | None = None,
        requested_at: float | None = None,
        on_progress: Callable[[DriveStatus], None] | None = None,
    ) -> Outcome:
        """Run at ``frequency_hz``, without ``direction`` forward (DF800: as the drive is set).

        ``wait``: return when the drive reports running at that frequency, within ``timeout_s`` (None: from its ramp,
        and as long as its speed approaches); ``on_progress`` is called with every status that is read meanwhile.
        ``requested_at``, by ``bus.now()``: a frame that moves leaves at most 5 s after it, checks included; None: at
        most 2 s after the checks.
        """
        parsed_direction = None if direction is None else Direction(direction)
        with self._runner.command(requested_at) as op:
            outcome = await self._stops.run_motion(start.run(op, frequency_hz, parsed_direction, will_wait=wait))
            if not wait:
                return outcome
            waiting = wait_at_speed(
                op, frequency_hz, outcome, timeout_s=timeout_s, direction=parsed_direction, on_progress=on_progress
            )
            return raise_for_status(await self._runner.run(waiting))

    async def set_frequency(self, frequency_hz: float, requested_at: float | None = None) -> Outcome:
        """Change the set frequency and read it back where the model shows it.

        ``requested_at``: as for ``run``; a frame that moves expires after 2 s, every other after 5 s.
        """
        with self._runner.command(requested_at) as op:
            return raise_for_status(await self._runner.run_command(setpoint.set_frequency(op, frequency_hz)))

    async def pause(self) -> Outcome:
        """Pause the run: the motor ramps down to 0 Hz and runs again with the next ``run``; ``stop`` ends it too.

        A paused drive still has its run command. Raises CapabilityError where the model has no pause.
        """
        with self._runner.command() as op:
            return raise_for_status(await self._runner.run_command(hold.pause(op)))

    async def hold_ramp(self, seconds: float, requested_at: float | None = None) -> Outcome:
        """Keep the output frequency where it is for ``seconds`` (above 0, at most 10), then go on with the ramp.

        Cancelled meanwhile, or where the drive does not acknowledge the end, the drive is stopped; ``requested_at``: as
        for ``run``. Raises CapabilityError where the model can't hold its ramp, and LimitError for the time or the
        frequency.
        """
        with self._runner.command(requested_at) as op, self._stops.stop_on_failure(op):
            return raise_for_status(await self._runner.run_command(hold.hold_ramp(op, seconds)))

    def jog(
        self,
        frequency_hz: float | None = None,
        direction: Direction | str = Direction.FORWARD,
        lease_s: float = MAX_JOG_LEASE_S,
        requested_at: float | None = None,
    ) -> JogSession:
        """Return a jog: ``async with drive.jog(5.0) as session`` jogs as long as the session is renewed.

        ``frequency_hz`` None is the drive's own jog frequency, the only one on models whose bus can't set it;
        ``requested_at``: as for ``run``. Raises LimitError for a lease above 0.5 s.
        """
        return JogSession(
            self._runner,
            self._stops,
            frequency_hz=frequency_hz,
            direction=Direction(direction),
            lease_s=lease_s,
            requested_at=requested_at,
        )

    def assume_model(self) -> None:
        """State that the drive at this address is of this model, as its name plate shows: stops are sent at once.

        Otherwise the first stop to a station waits for a read, where the model's command word is a number that may
        start another model, and is withheld where the reply is not one of this model.
        """
        self._context.model_assumed = True

    @property
    def is_model_known(self) -> bool:
        """Whether no command waits for the model check, and no other drive may have come to this address since."""
        try:
            is_offline = self.bus.presence(self.address) is Presence.OFFLINE
            was_lost = self.bus.contact_losses(self.address) != self.dialect.contact_losses
        except KeyError:  # the drive was removed
            return False
        return self.dialect.model_check() is None and not is_offline and not was_lost

    def withdraw_commands(self, why: Superseded) -> None:
        """Send no further frame of the commands under way: they fail with the error ``why``.

        What was sent is still confirmed by reads; stops go on, and so does a ramp hold, to its end.
        """
        self._context.withdrawal = why
        self.bus.withdraw_commands(self.address, why)

    async def stop(self, *, wait: bool = True, joint: JointStops | None = None) -> Outcome:
        """Stop along the ramp. Raises StopUnconfirmed where the drive does not report it; the stop is then repeated.

        ``joint``: stops of several drives of the bus that this one joins; None: it has the time of one drive. To stop
        all drives of a bus use ``stop_bus``.
        """
        return await self._stops.stop(StopMode.STOP, wait=wait, joint=joint)

    async def coast(self, *, wait: bool = True) -> Outcome:
        """Switch the output off; the motor runs out. Raises CapabilityError where the model has no such command."""
        return await self._stops.stop(StopMode.COAST, wait=wait)

    async def quick_stop(self, *, wait: bool = True) -> Outcome:
        """Stop by the drive's own fast stop. Not an emergency stop: only a hard-wired STO or SS1 is."""
        return await self._stops.stop(StopMode.QUICK_STOP, wait=wait)

    @property
    def stop_pending(self) -> bool:
        """Whether a stop was sent that the drive has not confirmed and that is being repeated."""
        return self._stops.pending

    @property
    def stopping(self) -> bool:
        """Whether a stop is under way or being repeated."""
        return self._stops.stopping

    @property
    def stop_exchanges(self) -> tuple[FrameExchange, ...]:
        """Frames of the stops under way, so far."""
        return self._stops.exchanges

    async def reset_fault(self) -> Outcome:
        """Reset a fault while the drive reports one; again only while it is unanswered and the fault verified."""
        with self._runner.command() as op:
            return raise_for_status(await self._runner.run_command(reset.reset_fault(op)))

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        """Read parameters in the manual's notation or signals by name. Raises ProfileError for an unknown name.

        The error lists each unknown name with similar ones; nothing is read then.
        """
        return await self._runner.run(parameters.read_values(self._read_context(), tuple(names)))

    async def write(self, values: Mapping[str, float | str], *, save: bool = False, force: bool = False) -> Outcome:
        """Write parameters to RAM, or with ``save`` to EEPROM; each is read back and named in the outcome's notes.

        A value is a number in the parameter's unit, or a text with the raw word in hexadecimal (``0010H``, ``0x10``);
        a later stop supersedes every write that has not been sent yet. ``force``: send also what raises
        ConfirmationRequired otherwise: a new address, baud rate or format, an input terminal that may start the motor,
        or a source of commands other than the bus.
        """
        with self._runner.command() as op:
            return raise_for_status(
                await self._runner.run_command(parameters.write_values(op, values, save=save, force=force))
            )

    def open_calibrations(self) -> tuple[CalibrationStep, ...]:
        """Return the calibration steps that are still to be done on this drive, in their order."""
        self._load_stored()
        return self._calibration.open_steps()

    async def calibrate(
        self, step: str, observe: Callable[[], Awaitable[Any]] | None = None, **inputs: Any
    ) -> CalibrationResult:
        """Run a calibration step, beside a person who watches the drive, and store the options that it determines.

        ``observe`` is called after a motion and asks the person for the observation, None where it was not seen;
        ``inputs``: of the step's operation. Raises CapabilityError where the drive has no such step.
        """
        return await self._calibration.run(step, observe, inputs)


def _store_for(bus: Bus) -> Store:
    return MemoryStore() if _is_volatile(bus) else FileStore(default_path())


def _nonce_start_for(bus: Bus) -> int:
    return DEFAULT_NONCE_START if _is_volatile(bus) else random_word()


def _is_volatile(bus: Bus) -> bool:
    return bus.port.url.partition(":")[0] in VOLATILE_SCHEMES
