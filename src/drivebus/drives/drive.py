"""``Drive``: one drive of any family on a bus. Every method is a conversation; this is the shell around them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusResult
from drivebus.drives.context import DriveContext, DriveLimits, Preflight
from drivebus.drives.dialects.base import Dialect, StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.jog_session import JogSession
from drivebus.drives.monitor import Monitor
from drivebus.drives.operations import calibration, comm_loss, identity, jog, parameters, reset, setpoint, start, status
from drivebus.drives.operations import preflight as preflights
from drivebus.drives.operations import stop as stopping
from drivebus.drives.operations.calibration import ScalingResult
from drivebus.drives.operations.comm_loss import CommLossReport
from drivebus.drives.operations.context import CHECKS_TIMEOUT_S, OperationContext
from drivebus.drives.operations.identity import Identity
from drivebus.drives.operations.reach import wait_at_speed
from drivebus.drives.operations.runner import run_operation, submit_first
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.outcome import raise_for_status
from drivebus.drives.state import Direction, DriveStatus, Outcome
from drivebus.drives.store import FileStore, MemoryStore, Store, default_path
from drivebus.errors import CapabilityError, Expired
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import StationTiming
from drivebus.values import Reading

T = TypeVar("T")
STOP_RETRY_S = 1.0
"""An unconfirmed stop is repeated this often until the drive confirms it or somebody commands anew (matrix 6.4)."""
MIN_WAIT_S = 1e-6
"""Less than this is not waited for: a loop's clock may not show it."""
VOLATILE_SCHEMES = ("sim", "memory", "replay")
"""Links whose drives have no EEPROM that wears and no bench where a proof was made."""


class Drive:
    """Control and monitor one drive.

    A command returns its Outcome where it is confirmed or acknowledged. Everything else raises, with the outcome on the
    error: CapabilityError, LimitError, PreflightError, StartInhibited, WearBudget and Expired before anything was sent;
    Refused, TargetNotReached, OutcomeUnknown, StopUnconfirmed and Superseded after.
    """

    def __init__(
        self,
        bus: Bus,
        profile: DriveProfile | str | Path,
        address: int,
        *,
        encoding: str | None = None,
        limits: DriveLimits | None = None,
        settings: Mapping[str, Any] | None = None,
        store: Store | None = None,
        timing: StationTiming | None = None,
    ) -> None:
        """Registers the drive on the bus. Raises ProfileError, ConfigurationError (address, encoding, setting)."""
        loaded = profile if isinstance(profile, DriveProfile) else profiles.load(profile)
        self.bus, self.profile, self.address = bus, loaded, address
        self._store = store if store is not None else _store_for(bus)
        self._explicit_settings = dict(settings or {})
        self.dialect: Dialect = create_dialect(
            loaded, address, encoding=encoding, settings=self._explicit_settings, timing=timing
        )
        given_limits = limits or DriveLimits()
        self._context = DriveContext(
            self.dialect, self._eeprom_budget(given_limits), given_limits, on_read=self._publish_read
        )
        self._read_listeners: list[Callable[[BusResult], None]] = []
        self._calibration_loaded = False
        self._lock = asyncio.Lock()
        self._stop_retry: asyncio.Task[None] | None = None
        self._running_stops: set[asyncio.Task[Outcome]] = set()
        self._retried_mode = StopMode.STOP
        self._load_calibration()
        bus.add_station(self.dialect.station_config)

    def close(self) -> None:
        """Take the drive off its bus; sends nothing."""
        self._cancel_stop_retry()
        self.bus.remove_station(self.address)

    @property
    def _store_key(self) -> str:
        """What proofs and wear are kept under."""
        return f"{self.bus.port.identity}/{self.address}"

    def _eeprom_budget(self, limits: DriveLimits) -> EepromBudget:
        return EepromBudget(self._store, self._store_key, limits.saves_per_day)

    def _load_calibration(self) -> None:
        """What was proved and worn before: known once the port is open, as only then it knows which device it is (F12).

        Before that ``/dev/ttyUSB0`` is a name that another line's adapter may have had.
        """
        if self._calibration_loaded or self.bus.is_closed:
            return
        self._calibration_loaded = True
        self._context.eeprom_budget = self._eeprom_budget(self._context.limits)
        for setting, value in self._stored_calibration().items():
            if setting not in self._explicit_settings:
                self.dialect.set_option(setting, value)

    async def _run(self, conversation: DriveOperation[T], begun: asyncio.Future[BusResult] | None = None) -> T:
        self._load_calibration()
        return await run_operation(conversation, self.bus, self.address, self._store, begun)

    def _new_operation(self, wished_at: float | None = None) -> OperationContext:
        """A command wished for now: a stop from now on takes it away, whatever it still waits for (6.5)."""
        now = self.bus.now()
        wished_at = None if wished_at is None else min(now, wished_at)  # by another clock it might never expire
        return OperationContext(
            self._context, self.bus.stop_epoch(self.address), now if wished_at is None else wished_at, wished_at
        )

    async def _serialized(self, conversation: DriveOperation[T]) -> T:
        """One command at a time; a stop never waits for this. Raises Expired for one that waited too long."""
        wished_at = self.bus.now()
        async with self._lock:
            waited_s = self.bus.now() - wished_at
            if waited_s > CHECKS_TIMEOUT_S:
                conversation.close()
                raise Expired("drives.turn_too_late", age_s=round(waited_s, 2), limit_s=CHECKS_TIMEOUT_S)
            return await self._run(conversation)

    async def _execute(self, conversation: DriveOperation[Outcome]) -> Outcome:
        return raise_for_status(await self._serialized(conversation))

    async def _execute_motion(self, conversation: DriveOperation[T]) -> T:
        """A command that begins motion ends the repetition of an old stop; where it does not end well, that goes on."""
        old = self._cancel_stop_retry()
        try:
            return await self._serialized(conversation)
        except BaseException:
            if old is not None and self._stop_retry is None:
                self._start_stop_retry(old)
            raise

    @contextlib.contextmanager
    def _stop_on_failure(self, talk: OperationContext) -> Iterator[None]:
        """A motion that must not outlast this block where it fails: it is stopped until that is confirmed."""
        try:
            yield
        except BaseException:
            if talk.may_be_running and self._stop_retry is None:
                self._start_stop_retry(StopMode.STOP)
            raise

    @property
    def limits(self) -> DriveLimits:
        """The user's own limits; what is set here holds from the next command on."""
        return self._context.limits

    @limits.setter
    def limits(self, limits: DriveLimits) -> None:
        self._context.limits = limits
        self._context.eeprom_budget = self._eeprom_budget(limits)

    @property
    def range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be set: the profile's and the user's limits together."""
        return self._context.minimum_hz, self._context.maximum_hz

    @property
    def acceleration_s(self) -> float | None:
        """Its ramp, where the pre-flight has read it."""
        return self._context.acceleration_s

    def set_poll_periods(self, profile: DriveProfile) -> None:
        """The same model with other periods: for the monitors that follow."""
        self.profile = self.dialect.profile = profile

    def check_frequency(self, frequency_hz: float) -> float:
        """What the drive makes of a frequency, in Hz. Raises LimitError; nothing is sent."""
        return self._context.check_frequency(frequency_hz)[1]

    # --- what it is doing ---------------------------------------------------------------------------------------

    async def status(self, signals: Iterable[str] | None = None) -> DriveStatus:
        """State, direction, fault and readings, read now. Raises the bus's error where the drive does not answer."""
        names = None if signals is None else tuple(signals)
        return await self._run(status.read_status(OperationContext(self._context), names))

    def monitor(
        self,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        period_s: float = 0.0,
    ) -> Monitor:
        """Poll these signals (None: all of the profile) until closed; ``on_change`` gets a status per answer.

        ``period_s``: nothing more often than that, for a line with more drives than the profile's own periods allow;
        readings are then good for three of these periods.
        """
        self._load_calibration()
        return Monitor(self.bus, self.dialect, signals, on_change, period_s, self._read_listeners)

    def _publish_read(self, answer: BusResult) -> None:
        """Monitors hear of it a turn later: whoever watches them must not hold up or break a command."""
        for hear in self._read_listeners:
            asyncio.get_running_loop().call_soon(hear, answer)

    async def identify(self) -> Identity:
        """What the drive says of itself (C320 class 0); for the others only that it answers."""
        return await self._run(identity.identify(OperationContext(self._context)))

    async def preflight(self) -> Preflight:
        """Does the drive listen to the bus? Read now; what is missing is in the result, not raised."""
        return await self._run(preflights.read_preflight(OperationContext(self._context)))

    async def comm_loss_behaviour(self) -> CommLossReport:
        """What the drive does by itself when nobody speaks to it any more."""
        return await self._run(comm_loss.comm_loss_behaviour(OperationContext(self._context)))

    # --- motion -------------------------------------------------------------------------------------------------

    async def run(
        self,
        frequency_hz: float,
        direction: Direction | str | None = None,
        wait: bool = False,
        timeout_s: float | None = None,
        requested_at: float | None = None,
    ) -> Outcome:
        """Run at ``frequency_hz``. ``direction`` None is forward (DF800: as the drive is set).

        ``wait``: return when the drive reports running at that frequency, within ``timeout_s`` (None: from its ramp).
        ``wished_at``: when somebody asked for it, by ``bus.now()``. Nothing that moves leaves more than 5 s after that,
        however long the checks take, nor 2 s after them (ruling 12); None: the checks have a limit of their own.
        """
        way = None if direction is None else Direction(direction)
        talk = self._new_operation(requested_at)
        outcome = raise_for_status(await self._execute_motion(start.run(talk, frequency_hz, way, will_wait=wait)))
        return (
            raise_for_status(await self._run(wait_at_speed(talk, frequency_hz, outcome, timeout_s)))
            if wait
            else outcome
        )

    async def set_frequency(self, frequency_hz: float, requested_at: float | None = None) -> Outcome:
        """Change the set frequency; absolute, read back where the model shows it.

        ``wished_at``: as for ``run``; a frame that moves has 2 s from it, every other 5 s.
        """
        return await self._execute(setpoint.set_frequency(self._new_operation(requested_at), frequency_hz))

    def jog(
        self,
        frequency_hz: float | None = None,
        direction: Direction | str = Direction.FORWARD,
        lease_s: float = jog.MAX_JOG_LEASE_S,
        requested_at: float | None = None,
    ) -> JogSession:
        """``async with drive.jog(5.0) as lease``: jogs while the lease is renewed.

        ``frequency_hz`` None is the drive's own jog frequency, the only one where the bus can't set it (Modbus models).
        ``wished_at``: as for ``run``.
        Raises LimitError for a lease above 0.5 s.
        """
        way = Direction(direction)
        turning: list[OperationContext] = []

        async def begin() -> Outcome:
            talk = self._new_operation(requested_at)
            turning.append(talk)
            with self._stop_on_failure(talk):
                return raise_for_status(await self._execute_motion(jog.begin_jog(talk, frequency_hz, way)))

        async def end() -> Outcome:
            return raise_for_status(
                await self._finish_stop(jog.end_jog(OperationContext(self._context)), StopMode.STOP), stop=True
            )

        def may_turn() -> bool:
            return any(talk.may_be_running for talk in turning)

        return JogSession(
            begin, end, lease_s, lambda: self._motion_age_s(turning[-1].last_motion_result), self.bus.now, may_turn
        )

    def _motion_age_s(self, moved: BusResult | None) -> float:
        """How long ago the last bit of a frame that moves was out."""
        if moved is None or moved.sent_at is None:
            return 0.0
        return max(0.0, self.bus.now() - moved.sent_at - self.bus.settings.seconds(len(moved.sent)))

    async def stop(self, wait: bool = True) -> Outcome:
        """Stop along the ramp. Raises StopUnconfirmed where the drive does not report it; the stop is then repeated.

        Its patience is that of one drive on a line of its own: for several at once there is ``bus_stop``.
        """
        return await self._stop(StopMode.STOP, wait)

    async def stop_concurrently(self, drive_count: int) -> Outcome:
        """``stop`` as one of so many drives of a line that are stopped at once: each waits for the others' turns."""
        return await self._stop(StopMode.STOP, True, drive_count)

    async def coast(self, wait: bool = True) -> Outcome:
        """Output off, the motor runs out. Raises CapabilityError where the model has no such command."""
        return await self._stop(StopMode.COAST, wait)

    async def quick_stop(self, wait: bool = True) -> Outcome:
        """The drive's own fast stop. Not an emergency stop: only a hard-wired STO or SS1 is."""
        return await self._stop(StopMode.QUICK_STOP, wait)

    async def _stop(self, how: StopMode, wait: bool, drives: int = 1) -> Outcome:
        """``drives``: as one of so many that are stopped at once, where each waits for the others' turns."""
        if how.value not in self.profile.capabilities:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=how.value)
        self._cancel_stop_retry()
        talk = OperationContext(self._context)
        progress = stopping.StopProgress(talk, self.bus.now(), drives)
        conversation = stopping.stop(talk, how, wait_confirmed=wait, progress=progress)
        self._load_calibration()
        begun = submit_first(conversation, self.bus, self.address)
        stopping_it = asyncio.ensure_future(self._finish_stop(conversation, how, begun))
        self._running_stops.add(stopping_it)
        stopping_it.add_done_callback(self._stop_ended)
        outcome = await self._await_stop(stopping_it, talk, progress, how)
        if outcome.key == "drives.stop_answered":
            return outcome
        return raise_for_status(outcome, stop=True)

    def _stop_ended(self, stop: asyncio.Task[Outcome]) -> None:
        """Whoever still waits for it hears how; one that nobody waits for may end with its drive's registration."""
        self._running_stops.discard(stop)
        if not stop.cancelled():
            stop.exception()

    async def _await_stop(
        self, stopping_it: asyncio.Task[Outcome], talk: OperationContext, progress: stopping.StopProgress, how: StopMode
    ) -> Outcome:
        """How it ended, or in time that it did not, and then it is begun anew: its reads may wait for their turn (G07).

        Whoever gives up waiting for this does not take the stop back.
        """
        while not stopping_it.done():
            left_s = progress.deadline - self.bus.now()
            if left_s <= MIN_WAIT_S:
                stopping_it.cancel()
                self._start_stop_retry(how)
                return stopping.unconfirmed_outcome(talk)
            await asyncio.wait({stopping_it}, timeout=left_s)
        return stopping_it.result()

    async def _finish_stop(
        self, conversation: DriveOperation[Outcome], how: StopMode, begun: asyncio.Future[BusResult] | None = None
    ) -> Outcome:
        """What became of a stop; where that is not known it is repeated from now on."""
        outcome = await self._run(conversation, begun)
        if outcome.succeeded:
            self._cancel_stop_retry()
        else:
            self._start_stop_retry(how)
        return outcome

    @property
    def stop_pending(self) -> bool:
        """A stop was sent that the drive has not confirmed; it is being repeated."""
        return self._stop_retry is not None and not self._stop_retry.done()

    @property
    def stopping(self) -> bool:
        """A stop is under way, or was not confirmed and is being repeated."""
        return bool(self._running_stops) or self.stop_pending

    def _start_stop_retry(self, how: StopMode) -> None:
        self._cancel_stop_retry()
        self._retried_mode = how
        self._stop_retry = asyncio.ensure_future(self._retry_stop(how))

    async def _retry_stop(self, how: StopMode) -> None:
        """Repeat an unconfirmed stop until the drive confirms it, or the bus is closed for good."""
        while not self.bus.is_closed:
            outcome = await self._run(stopping.stop(OperationContext(self._context), how))
            if outcome.succeeded:
                return
            await asyncio.sleep(STOP_RETRY_S)

    def _cancel_stop_retry(self) -> StopMode | None:
        """End the repetition of an old stop; which one it was, None where there was none."""
        pending, task, self._stop_retry = self.stop_pending, self._stop_retry, None
        if task is not None:
            task.cancel()
        return self._retried_mode if pending else None

    async def reset_fault(self) -> Outcome:
        """Reset a fault, once, while the drive reports one."""
        return await self._execute(reset.reset_fault(self._new_operation()))

    # --- parameters ---------------------------------------------------------------------------------------------

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        """Parameters in the manual's notation, or signals by name. Raises ProfileError for a name nobody knows."""
        return await self._run(parameters.read_values(OperationContext(self._context), tuple(names)))

    async def write(self, values: Mapping[str, float], save: bool = False) -> Outcome:
        """Write parameters to RAM, or with ``save`` to EEPROM; each is read back, and named in the outcome's notes."""
        return await self._execute(parameters.write_values(OperationContext(self._context), values, save))

    # --- bench proofs -------------------------------------------------------------------------------------------

    async def calibrate_query_coding(self, keypad_hz: float = calibration.DEFAULT_KEYPAD_HZ) -> ScalingResult:
        """DZB100: ``keypad_hz`` stands on the keypad; Q00 names the query coding, which is then kept."""
        found = await self._run(calibration.calibrate_query_coding(OperationContext(self._context), keypad_hz))
        if found.coding is not None:
            await self._save_calibration("query_coding", found.coding)
        return found

    async def calibrate_setpoint_coding(self, direction: Direction | str | None = None) -> ScalingResult:
        """DZB100: runs at 5 Hz or less, a person watching, until one setpoint coding is left, which is then kept."""
        way = None if direction is None else Direction(direction)
        talk = self._new_operation()
        with self._stop_on_failure(talk):
            found = await self._execute_motion(calibration.calibrate_setpoint_coding(talk, way))
        if found.coding is not None:
            await self._save_calibration("setpoint_coding", found.coding)
        return found

    async def calibrate_direction(
        self, frequency_hz: float, watched: Callable[[], Awaitable[Direction | None]]
    ) -> Outcome:
        """DF800: one jog of 0.5 s; ``watched`` asks the person which way it turned (None: could not tell)."""
        talk = self._new_operation()
        with self._stop_on_failure(talk):
            outcome = raise_for_status(await self._execute_motion(calibration.calibration_jog(talk, frequency_hz)))
        seen = await watched()
        if seen is not None:
            await self._save_calibration("direction_field", calibration.direction_field_for(seen))
            await self._save_calibration("direction_proved", True)
        return outcome

    async def _save_calibration(self, setting: str, value: Any) -> None:
        self.dialect.set_option(setting, value)
        await asyncio.to_thread(self._store.put, self._calibration_key(setting), json.dumps(value))

    def _calibration_key(self, setting: str) -> str:
        return f"proof/{self._store_key}/{self.profile.model}/{setting}"

    def _stored_calibration(self) -> dict[str, Any]:
        """What was proved on this drive before; a record that can't be read proves nothing."""
        found: dict[str, Any] = {}
        for setting in self.profile.settings:
            text = self._store.get(self._calibration_key(setting))
            with contextlib.suppress(ValueError):
                found |= {} if text is None else {setting: json.loads(text)}
        return found


def _store_for(bus: Bus) -> Store:
    scheme = bus.port.url.partition(":")[0]
    return MemoryStore() if scheme in VOLATILE_SCHEMES else FileStore(default_path())
