"""The synchronous twin, for scripts and notebooks: the same drives, one call after the other.

    from drivebus import blocking

    with blocking.open_bus("sim://c320@1", baud=9600, format="8E1") as bus:
        drive = blocking.Drive(bus, "c320", 1)
        drive.run(25.0, wait=True)
        drive.stop()

The bus lives on an event loop in a thread of its own; every call waits for its end there. Nothing is decided here.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from concurrent import futures
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from drivebus import drives
from drivebus.bus import Bus as AsyncBus
from drivebus.bus import BusStatistics, StationHealth
from drivebus.drives.context import DriveLimits, Preflight
from drivebus.drives.jog_session import JogSession
from drivebus.drives.operations.calibration import DEFAULT_KEYPAD_HZ, ScalingResult
from drivebus.drives.operations.status import CommLossReport, Identity
from drivebus.drives.state import Direction, DriveStatus, Outcome
from drivebus.profiles.model import DriveProfile
from drivebus.values import Reading

__all__ = ["Bus", "Drive", "Lease", "Monitor", "open_bus", "stop_bus"]

T = TypeVar("T")


class Bus:
    """One bus on a thread of its own. Made by ``open_bus``; a context manager."""

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
        """Run a coroutine on the bus's loop to its end. An interrupt cancels it: nothing more of it is sent."""
        future = self.start(coroutine)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def start(self, coroutine: Coroutine[Any, Any, T]) -> futures.Future[T]:
        """Start a coroutine on the bus's loop; whoever asked may cancel it or wait for its end."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function on the bus's loop (a coroutine function is awaited)."""

        async def there() -> Any:
            found = function(*arguments)
            return await found if asyncio.iscoroutine(found) else found

        return self.run(there())

    def statistics(self) -> BusStatistics:
        """Load, rates, reply times and errors."""
        found: BusStatistics = self.call(self.bus.statistics)
        return found

    def health(self, address: int) -> StationHealth:
        """Presence, error rate, foreign master, duplicate address. Raises KeyError for an address without a drive."""
        found: StationHealth = self.call(self.bus.health, address)
        return found

    @property
    def foreign_master(self) -> bool:
        """Whether another master has sent requests on this bus within the last minute."""
        return bool(self.call(lambda: self.bus.foreign_master))

    def inhibit_start(self, addresses: Iterable[int] | None = None) -> None:
        """No frame that may move a motor leaves for these stations (None: all) until ``release``."""
        self.call(self.bus.inhibit_start, addresses)

    def release_start(self, addresses: Iterable[int] | None = None) -> None:
        """The reset after a bus stop: motion is allowed again, nothing starts by itself."""
        self.call(self.bus.release_start, addresses)

    def start_inhibited(self, address: int) -> bool:
        """Does a bus stop hold this station? Raises KeyError."""
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
        """What still runs (a repeated stop) ends with the bus."""
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.call_soon(self._loop.stop)

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


async def _open(make: Callable[[], AsyncBus]) -> AsyncBus:
    bus = make()
    await bus.open()
    return bus


def open_bus(url: str, *, baud: int | None = None, format: str | None = None) -> Bus:
    """An open bus on a LINK such as ``/dev/ttyUSB0``, ``tcp://host:port`` or ``sim://c320@1``.

    Raises PortUrlError, PortUnavailable.
    """
    import drivebus

    return Bus(lambda: drivebus.open_bus(url, baud=baud, format=format))


class Lease:
    """``with drive.jog(5.0) as lease: ... lease.renew()``."""

    def __init__(self, bus: Bus, lease: JogSession) -> None:
        self._bus, self._lease = bus, lease

    def renew(self) -> None:
        """The hand is still on the key. Raises StartInhibited once the lease was lost."""
        self._bus.call(self._lease.renew)

    @property
    def expired(self) -> bool:
        """The lease ran out and the jog was stopped."""
        return self._lease.expired

    def __enter__(self) -> Lease:
        self._bus.run(self._lease.start())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bus.run(self._lease.stop())


class Monitor:
    """``with drive.monitor() as monitor: ... monitor.status()``: the newest readings, polled in the background."""

    def __init__(self, bus: Bus, make: Callable[[], drives.Monitor]) -> None:
        self._bus = bus
        self._monitor: drives.Monitor = bus.call(make)

    def status(self) -> DriveStatus:
        """The newest readings; what is too old is marked bad, and an old state is UNKNOWN. Sends nothing."""
        found: DriveStatus = self._bus.call(self._monitor.status)
        return found

    @property
    def last_error(self) -> Exception | None:
        """Why the newest poll got no reply, None where it got one."""
        return self._monitor.last_error

    def close(self) -> None:
        """No more polls. Idempotent."""
        self._bus.call(self._monitor.close)

    def __enter__(self) -> Monitor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Drive:
    """One drive; the methods of ``drivebus.Drive``, each returning when it is done. Same results, same errors."""

    def __init__(self, bus: Bus, profile: DriveProfile | str | Path, address: int, **options: Any) -> None:
        self._bus = bus
        self.drive: drives.Drive = bus.call(lambda: drives.Drive(bus.bus, profile, address, **options))

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
        wait: bool = False,
        timeout_s: float | None = None,
        requested_at: float | None = None,
    ) -> Outcome:
        return self._bus.run(self.drive.run(frequency_hz, direction, wait, timeout_s, requested_at))

    def set_frequency(self, frequency_hz: float, requested_at: float | None = None) -> Outcome:
        return self._bus.run(self.drive.set_frequency(frequency_hz, requested_at))

    def jog(
        self,
        frequency_hz: float | None = None,
        direction: Direction | str = "forward",
        lease_s: float = 0.5,
        requested_at: float | None = None,
    ) -> Lease:
        return Lease(self._bus, self.drive.jog(frequency_hz, direction, lease_s, requested_at))

    def stop(self, wait: bool = True) -> Outcome:
        return self._bus.run(self.drive.stop(wait))

    def coast(self, wait: bool = True) -> Outcome:
        return self._bus.run(self.drive.coast(wait))

    def quick_stop(self, wait: bool = True) -> Outcome:
        return self._bus.run(self.drive.quick_stop(wait))

    @property
    def stop_pending(self) -> bool:
        """A stop was sent that the drive has not confirmed; it is being repeated while the bus is open."""
        return self.drive.stop_pending

    @property
    def stopping(self) -> bool:
        """A stop is under way, or was not confirmed and is being repeated."""
        return self.drive.stopping

    def stop_concurrently(self, drive_count: int) -> Outcome:
        return self._bus.run(self.drive.stop_concurrently(drive_count))

    @property
    def limits(self) -> DriveLimits:
        """The user's own limits; what is set here holds from the next command on."""
        return self.drive.limits

    @limits.setter
    def limits(self, limits: DriveLimits) -> None:
        self._bus.call(lambda: setattr(self.drive, "limits", limits))

    @property
    def range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be set."""
        return self.drive.range_hz

    @property
    def acceleration_s(self) -> float | None:
        """Its ramp, where the pre-flight has read it."""
        return self.drive.acceleration_s

    def check_frequency(self, frequency_hz: float) -> float:
        """What the drive makes of a frequency, in Hz. Raises LimitError; nothing is sent."""
        return self.drive.check_frequency(frequency_hz)

    def set_poll_periods(self, profile: DriveProfile) -> None:
        """The same model with other periods: for the monitors that follow."""
        self._bus.call(lambda: self.drive.set_poll_periods(profile))

    def reset_fault(self) -> Outcome:
        return self._bus.run(self.drive.reset_fault())

    def read(self, names: Iterable[str]) -> dict[str, Reading]:
        return self._bus.run(self.drive.read(names))

    def write(self, values: Mapping[str, float], save: bool = False) -> Outcome:
        return self._bus.run(self.drive.write(values, save))

    def identify(self) -> Identity:
        return self._bus.run(self.drive.identify())

    def preflight(self) -> Preflight:
        return self._bus.run(self.drive.preflight())

    def comm_loss_behaviour(self) -> CommLossReport:
        return self._bus.run(self.drive.comm_loss_behaviour())

    def calibrate_query_coding(self, keypad_hz: float = DEFAULT_KEYPAD_HZ) -> ScalingResult:
        return self._bus.run(self.drive.calibrate_query_coding(keypad_hz))

    def calibrate_setpoint_coding(self, direction: Direction | str | None = None) -> ScalingResult:
        return self._bus.run(self.drive.calibrate_setpoint_coding(direction))

    def calibrate_direction(self, frequency_hz: float, watched: Callable[[], Direction | None]) -> Outcome:
        """One jog; then ``watched`` is called on the caller's own thread (it may ask with ``input``)."""
        jogged: futures.Future[None] = futures.Future()
        seen: futures.Future[Direction | None] = futures.Future()

        async def asked() -> Direction | None:
            jogged.set_result(None)
            return await asyncio.wrap_future(seen)

        proof = self._bus.start(self.drive.calibrate_direction(frequency_hz, asked))
        ends: tuple[futures.Future[Any], ...] = (jogged, proof)
        try:
            futures.wait(ends, return_when=futures.FIRST_COMPLETED)
            if jogged.done():
                seen.set_result(watched())
            return proof.result()
        except BaseException:
            proof.cancel()
            raise

    def close(self) -> None:
        """Take the drive off its bus; sends nothing."""
        self._bus.call(self.drive.close)


def stop_bus(bus: Bus, stopped: Sequence[Drive]) -> drives.StopReport:
    """Stop every drive of a bus; see ``drivebus.stop_bus``."""
    return bus.run(drives.stop_bus(bus.bus, [one.drive for one in stopped]))
