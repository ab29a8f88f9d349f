"""Synchronous API for scripts and notebooks: the same drives, without ``await``.

    from drivebus import blocking

    with blocking.open_bus("sim://c320@1", baud=9600, format="8E1") as bus:
        drive = blocking.Drive(bus, "c320", 1)
        drive.run(25.0, wait=True)
        drive.stop()

The bus runs on an event loop in a thread of its own; every call waits there for its result. Each class has the name of
its asynchronous twin in ``drivebus``, so that a script changes only its import and its ``await``.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from concurrent import futures
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from drivebus.bus import Bus as AsyncBus
from drivebus.bus import BusStatistics, StationHealth
from drivebus.drives import Drive as AsyncDrive
from drivebus.drives import Monitor as AsyncMonitor
from drivebus.drives import StopReport
from drivebus.drives import stop_all_addresses as async_stop_all_addresses
from drivebus.drives import stop_bus as async_stop_bus
from drivebus.drives.context import DriveLimits, Preflight
from drivebus.drives.dialects.base import Identity
from drivebus.drives.jog_session import JogSession as AsyncJogSession
from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep
from drivebus.drives.operations.jog import MAX_JOG_LEASE_S
from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.drives.operations.status import CommLossReport
from drivebus.drives.outcome import FrameExchange, Outcome
from drivebus.drives.state import Direction, DriveStatus
from drivebus.drives.stop_supervisor import JointStops
from drivebus.drives.store import Store
from drivebus.errors import Superseded
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import StationTiming
from drivebus.values import Reading

__all__ = ["Bus", "Drive", "JogSession", "Monitor", "open_bus", "stop_all_addresses", "stop_bus"]

T = TypeVar("T")


class Bus:
    """Bus on a thread of its own, opened by ``open_bus``. A context manager."""

    def __init__(self, factory: Callable[[], AsyncBus]) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="drivebus", daemon=True)
        self._thread.start()
        try:
            self.bus = self.call(_open, factory)
        except BaseException:
            self._stop_thread()
            raise

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine on the bus's loop and return its result. An interrupt cancels it: nothing more is sent."""
        future = self.start(coroutine)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def start(self, coroutine: Coroutine[Any, Any, T]) -> futures.Future[T]:
        """Start a coroutine on the bus's loop and return its future."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function on the bus's loop, awaiting a coroutine function, and return its result."""

        async def on_loop() -> Any:
            result = function(*arguments)
            return await result if asyncio.iscoroutine(result) else result

        return self.run(on_loop())

    def statistics(self) -> BusStatistics:
        """Return load, rates, reply times, errors and bytes, of the bus and of each station."""
        result: BusStatistics = self.call(self.bus.statistics)
        return result

    def health(self, address: int) -> StationHealth:
        """Return presence, error rates, foreign master, duplicate address. Raises KeyError: address not registered."""
        result: StationHealth = self.call(self.bus.health, address)
        return result

    def contact_losses(self, address: int) -> int:
        """Return how often the port was lost, or a reply came after 10 s of silence or 2 minutes without request."""
        return int(self.call(self.bus.contact_losses, address))

    def unusable_reply(self, address: int) -> Exception | None:
        """Return what a station that is not online sends in place of a reply, None for silence. Raises KeyError."""
        error: Exception | None = self.call(self.bus.unusable_reply, address)
        return error

    @property
    def foreign_master(self) -> bool:
        """Whether another master has sent requests on this bus within the last minute."""
        return bool(self.call(lambda: self.bus.foreign_master))

    def inhibit_start(self, addresses: Iterable[int] | None = None) -> None:
        """Refuse every frame that may move a motor of these stations (None: all) until ``release_start``."""
        self.call(self.bus.inhibit_start, addresses)

    def release_start(self, addresses: Iterable[int] | None = None) -> None:
        """Reset the start inhibit: motion is permitted again, and no motor starts by itself."""
        self.call(self.bus.release_start, addresses)

    def start_inhibited(self, address: int) -> bool:
        """Return whether a start inhibit applies to this station. Raises KeyError."""
        return bool(self.call(self.bus.start_inhibited, address))

    def close(self) -> None:
        """Close the port and end the thread. Idempotent."""
        if self._thread.is_alive():
            self.call(self.bus.close)
            self._stop_thread()

    def _stop_thread(self) -> None:
        self.run(self._loop.shutdown_default_executor())
        self._loop.call_soon_threadsafe(self._cancel_all)
        self._thread.join()
        self._loop.close()

    def _cancel_all(self) -> None:
        """Cancel the tasks that still run, such as a repeated stop."""
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.call_soon(self._loop.stop)

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


async def _open(factory: Callable[[], AsyncBus]) -> AsyncBus:
    bus = factory()
    await bus.open()
    return bus


def open_bus(url: str, *, baud: int | None = None, format: str | None = None) -> Bus:
    """Open a bus on a port URL such as ``/dev/ttyUSB0``, ``tcp://host:port`` or ``sim://c320@1``.

    Raises PortUrlError, PortUnavailable.
    """
    import drivebus

    return Bus(lambda: drivebus.open_bus(url, baud=baud, format=format))


class JogSession:
    """Jog that stops unless it is renewed: ``with drive.jog(5.0) as session: ... session.renew()``."""

    def __init__(self, bus: Bus, session: AsyncJogSession) -> None:
        self._bus, self._session = bus, session

    def renew(self) -> None:
        """Dead-man keep-alive: extend the session. Raises StartInhibited once it has expired."""
        self._bus.call(self._session.renew)

    @property
    def expired(self) -> bool:
        """Whether the session was not renewed in time and the jog was stopped."""
        return self._session.expired

    def __enter__(self) -> JogSession:
        self._bus.run(self._session.start())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bus.run(self._session.stop())


class Monitor:
    """Newest readings, polled in the background: ``with drive.monitor() as monitor: ... monitor.status()``."""

    def __init__(self, bus: Bus, make: Callable[[], AsyncMonitor]) -> None:
        self._bus = bus
        self._monitor: AsyncMonitor = bus.call(make)

    def status(self) -> DriveStatus:
        """Return the newest readings; old ones are marked bad, and an old state is UNKNOWN. Sends nothing."""
        result: DriveStatus = self._bus.call(self._monitor.status)
        return result

    @property
    def last_error(self) -> Exception | None:
        """Error of the newest poll, None where it got a reply."""
        return self._monitor.last_error

    def poll_state(self) -> None:
        """Poll the state at once: on a bus with many drives its next turn is seconds later."""
        self._bus.call(self._monitor.poll_state)

    def close(self) -> None:
        """End the polls. Idempotent."""
        self._bus.call(self._monitor.close)

    def __enter__(self) -> Monitor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Drive:
    """Drive with the methods of ``drivebus.Drive``: same results, same errors, each returns when it is done."""

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
        """Register the drive on the bus, as ``drivebus.Drive`` does. Raises ProfileError, ConfigurationError.

        ``on_repeated_stop`` is called on the bus's thread: be quick there, and call no drive.
        """
        self._bus = bus
        self.drive: AsyncDrive = bus.call(
            lambda: AsyncDrive(
                bus.bus,
                profile,
                address,
                encoding=encoding,
                limits=limits,
                options=options,
                store=store,
                timing=timing,
                nonce_start=nonce_start,
                on_repeated_stop=on_repeated_stop,
            )
        )

    def status(self, signals: Iterable[str] | None = None) -> DriveStatus:
        return self._bus.run(self.drive.status(signals))

    def monitor(
        self,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        period_s: float = 0.0,
    ) -> Monitor:
        """Poll in the background. ``on_change`` is called on the bus's thread: be quick there, and call no drive."""
        return Monitor(self._bus, lambda: self.drive.monitor(signals, on_change, period_s))

    def run(
        self,
        frequency_hz: float,
        direction: Direction | str | None = None,
        *,
        wait: bool = False,
        timeout_s: float | None = None,
        requested_at: float | None = None,
        on_progress: Callable[[DriveStatus], None] | None = None,
    ) -> Outcome:
        """Run at ``frequency_hz``. ``on_progress`` is called on the bus's thread: be quick there, and call no drive."""
        return self._bus.run(
            self.drive.run(
                frequency_hz,
                direction,
                wait=wait,
                timeout_s=timeout_s,
                requested_at=requested_at,
                on_progress=on_progress,
            )
        )

    def set_frequency(self, frequency_hz: float, requested_at: float | None = None) -> Outcome:
        return self._bus.run(self.drive.set_frequency(frequency_hz, requested_at))

    def jog(
        self,
        frequency_hz: float | None = None,
        direction: Direction | str = "forward",
        lease_s: float = MAX_JOG_LEASE_S,
        requested_at: float | None = None,
    ) -> JogSession:
        return JogSession(self._bus, self.drive.jog(frequency_hz, direction, lease_s, requested_at))

    def withdraw_commands(self, why: Superseded) -> None:
        self._bus.call(self.drive.withdraw_commands, why)

    def assume_model(self) -> None:
        self.drive.assume_model()

    def stop(self, *, wait: bool = True, joint: JointStops | None = None) -> Outcome:
        return self._bus.run(self.drive.stop(wait=wait, joint=joint))

    def coast(self, *, wait: bool = True) -> Outcome:
        return self._bus.run(self.drive.coast(wait=wait))

    def quick_stop(self, *, wait: bool = True) -> Outcome:
        return self._bus.run(self.drive.quick_stop(wait=wait))

    def pause(self) -> Outcome:
        return self._bus.run(self.drive.pause())

    def hold_ramp(self, seconds: float, requested_at: float | None = None) -> Outcome:
        return self._bus.run(self.drive.hold_ramp(seconds, requested_at))

    @property
    def stop_pending(self) -> bool:
        """Whether a stop was sent that the drive has not confirmed; it is repeated while the bus is open."""
        return self.drive.stop_pending

    @property
    def stopping(self) -> bool:
        """Whether a stop is in progress, or was not confirmed and is repeated."""
        return self.drive.stopping

    @property
    def stop_exchanges(self) -> tuple[FrameExchange, ...]:
        """Frames of the stops under way, so far."""
        return self.drive.stop_exchanges

    @property
    def limits(self) -> DriveLimits:
        """Limits of the user; a change applies from the next command on."""
        return self.drive.limits

    @limits.setter
    def limits(self, limits: DriveLimits) -> None:
        self._bus.call(lambda: setattr(self.drive, "limits", limits))

    @property
    def range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be set, in Hz."""
        return self.drive.range_hz

    @property
    def setpoint_cap_hz(self) -> float | None:
        """Highest frequency that is sent while the scale of the setpoint is not determined; None: no cap holds."""
        return self.drive.setpoint_cap_hz

    @property
    def is_model_known(self) -> bool:
        """Whether no command waits for the model check, and no other drive may have come to this address since."""
        return bool(self._bus.call(lambda: self.drive.is_model_known))

    @property
    def acceleration_s(self) -> float | None:
        """Acceleration time in seconds, None where the preflight check has not read it."""
        return self.drive.acceleration_s

    def check_frequency(self, frequency_hz: float) -> float:
        """Return the frequency in Hz as the drive would round it. Raises LimitError; sends nothing."""
        return self.drive.check_frequency(frequency_hz)

    def set_poll_periods(self, profile: DriveProfile) -> None:
        """Set the poll periods of monitors started from now on."""
        self._bus.call(lambda: self.drive.set_poll_periods(profile))

    def reset_fault(self) -> Outcome:
        return self._bus.run(self.drive.reset_fault())

    def read(self, names: Iterable[str]) -> dict[str, Reading]:
        return self._bus.run(self.drive.read(names))

    def write(self, values: Mapping[str, float | str], *, save: bool = False, force: bool = False) -> Outcome:
        return self._bus.run(self.drive.write(values, save=save, force=force))

    def identify(self) -> Identity:
        return self._bus.run(self.drive.identify())

    def loopback_test(self, count: int = 10, is_cancelled: Callable[[], bool] | None = None) -> LoopbackReport:
        return self._bus.run(self.drive.loopback_test(count, is_cancelled))

    def preflight(self) -> Preflight:
        return self._bus.run(self.drive.preflight())

    def comm_loss_behaviour(self) -> CommLossReport:
        return self._bus.run(self.drive.comm_loss_behaviour())

    def open_calibrations(self) -> tuple[CalibrationStep, ...]:
        """Return the calibration steps that are still to be done on this drive, in their order."""
        steps: tuple[CalibrationStep, ...] = self._bus.call(self.drive.open_calibrations)
        return steps

    def calibrate(self, step: str, observe: Callable[[], Any] | None = None, **inputs: Any) -> CalibrationResult:
        """Run a calibration step, then call ``observe`` on the caller's own thread (it may use ``input``)."""
        moved: futures.Future[None] = futures.Future()
        observation: futures.Future[Any] = futures.Future()

        async def answer() -> Any:
            moved.set_result(None)
            return await asyncio.wrap_future(observation)

        calibration = self._bus.start(self.drive.calibrate(step, None if observe is None else answer, **inputs))
        ends: tuple[futures.Future[Any], ...] = (moved, calibration)
        try:
            futures.wait(ends, return_when=futures.FIRST_COMPLETED)
            if moved.done() and observe is not None:
                observation.set_result(observe())
            return calibration.result()
        except BaseException:
            calibration.cancel()
            raise

    def close(self) -> None:
        """Remove the drive from its bus; sends nothing."""
        self._bus.call(self.drive.close)


def stop_bus(bus: Bus, drives: Sequence[Drive]) -> StopReport:
    """Stop every drive on a bus; see ``drivebus.stop_bus``."""
    return bus.run(async_stop_bus(bus.bus, [each.drive for each in drives]))


def stop_all_addresses(
    bus: Bus, drives: Sequence[Drive], on_progress: Callable[[Drive, float], None] | None = None
) -> StopReport:
    """Stop a bus whose addresses are not known; see ``drivebus.stop_all_addresses``.

    ``on_progress`` is called on the bus's thread: be quick there, and call no drive.
    """
    by_async_drive = {each.drive: each for each in drives}

    def report(drive: AsyncDrive, share: float) -> None:
        if on_progress is not None:
            on_progress(by_async_drive[drive], share)

    return bus.run(async_stop_all_addresses(bus.bus, list(by_async_drive), report))
