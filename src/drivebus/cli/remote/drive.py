"""Drive of a service with the interface of ``drives.Drive``, so that each command is written once.

A command takes the control lease of the drive and keeps it until ``close``; a stop needs none.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace, TracebackType
from typing import TYPE_CHECKING, Any

from drivebus.cli.remote.client import RemoteClient
from drivebus.cli.remote.convert import parse_loopback, parse_outcome, parse_reading, parse_status, reading_time
from drivebus.cli.stop_errors import stop_errors
from drivebus.errors import DrivebusError, NotFound, ServiceUnavailable, before_motion
from drivebus.service.api.errors import error_from_json
from drivebus.service.api.operations import Operation
from drivebus.service.api.operations.comm_loss import COMM_LOSS_TEST
from drivebus.service.api.operations.control import LEASE_RELEASE, LEASE_RENEW, LEASE_TAKE
from drivebus.service.api.operations.drives import (
    DRIVE_ARM,
    DRIVE_HOLD_RAMP,
    DRIVE_JOG,
    DRIVE_JOG_END,
    DRIVE_JOG_RENEW,
    DRIVE_PAUSE,
    DRIVE_RESET,
    DRIVE_RUN,
    DRIVE_SET_FREQUENCY,
    DRIVE_STOP,
    DRIVES_GET,
    LOOPBACK_TEST,
    PARAMETERS_READ,
    PARAMETERS_WRITE,
)
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.drives.operations.loopback import LoopbackReport
    from drivebus.drives.outcome import Outcome
    from drivebus.drives.state import Direction, DriveStatus
    from drivebus.profiles import DriveProfile
    from drivebus.values import Reading

LEASE_RENEW_PERIOD_S = 3.0  # a lease lasts ten seconds
FRESH_STATE_TIMEOUT_S = 3.0  # after a start, ``status`` waits this long for a newer state
STATE_POLL_PERIOD_S = 0.1


class RemoteBus:
    """Interface of ``bus.Bus`` that the commands use: clock and station health."""

    @staticmethod
    def now() -> float:
        return time.monotonic()

    @staticmethod
    def health(address: int) -> Any:
        """Report no foreign master: the service names it in the error of a rejected operation."""
        return SimpleNamespace(foreign_master=False)


class RemoteDrive:
    """Drive with a name in the plant of a service."""

    def __init__(
        self,
        client: RemoteClient,
        name: str,
        address: int,
        profile: DriveProfile,
        on_control_request: Callable[[Json], None] | None = None,
    ) -> None:
        """``on_control_request`` is called once for each request of another user for control of this drive."""
        self._client, self.name, self.address, self.profile = client, name, address, profile
        self._on_control_request = on_control_request
        self._reported_request: str | None = None
        self._renewal: asyncio.Task[None] | None = None
        self._had_control_before = self._assume_model = False
        self._started_at: float | None = None
        self.last_stop: Json | None = None
        """Stop that was requested after the last start, as of the newest status; None: no stop was requested."""

    async def call(self, operation: Operation, **params: Any) -> Json:
        """Execute an operation on this drive."""
        return await self._client.call(operation.name, {"drive": self.name, **params})

    # --- reads ----------------------------------------------------------------------------------------------------

    async def status(self) -> DriveStatus:
        """Read the status. Raises ControlNotHeld once the lease is lost: another user commands the drive."""
        if self._renewal is not None and self._renewal.done():
            self._renewal.result()
        now = RemoteBus.now()
        view = await self.call(DRIVES_GET)
        while self._state_is_older_than_start(view, now) and now - (self._started_at or now) < FRESH_STATE_TIMEOUT_S:
            await asyncio.sleep(STATE_POLL_PERIOD_S)
            now = RemoteBus.now()
            view = await self.call(DRIVES_GET)
        self.last_stop = view["last_stop"]
        return parse_status(view, now)

    def _state_is_older_than_start(self, view: Json, now: float) -> bool:
        """Return whether the state was read before the start of the drive."""
        state_at = reading_time(view["state_time_ms"], view["time_ms"], now)
        return self._started_at is not None and (state_at is None or state_at < self._started_at)

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        result = await self.call(PARAMETERS_READ, names=list(names))
        for error in result["refused"].values():
            raise error_from_json(error)
        return {name: parse_reading(value) for name, value in result["parameters"].items()}

    async def loopback_test(self, count: int = 10) -> LoopbackReport:
        return parse_loopback(await self.call(LOOPBACK_TEST, count=count))

    async def comm_loss_behaviour(self) -> Any:
        """Return the behaviour that the service has read from the drive."""
        comm_loss = (await self.call(DRIVES_GET))["comm_loss"]
        text = comm_loss["text"] or {}
        stops = {"trips": True, "runs_on": False}.get(comm_loss["kind"])
        return SimpleNamespace(stops_on_comm_loss=stops, text=lambda language: text.get(language, ""))

    # --- commands -----------------------------------------------------------------------------------------------

    async def run(self, frequency_hz: float, direction: Direction | None = None, *, wait: bool = False) -> Outcome:
        """Start the drive. ``wait`` has no effect: with a service ``--wait`` is rejected before."""
        params: Json = {"frequency_hz": frequency_hz} | ({"direction": str(direction)} if direction else {})
        with before_motion():
            params |= await self.arm()
        outcome = parse_outcome(await self.call(DRIVE_RUN, **params))
        self.note_start()
        return outcome

    def note_start(self) -> None:
        """Note that the motor was started now: ``status`` waits for a newer state."""
        self._started_at = RemoteBus.now()

    async def set_frequency(self, frequency_hz: float) -> Outcome:
        return await self._call_with_control(DRIVE_SET_FREQUENCY, frequency_hz=frequency_hz)

    async def pause(self) -> Outcome:
        return await self._call_with_control(DRIVE_PAUSE)

    async def hold_ramp(self, seconds: float) -> Outcome:
        return await self._call_with_control(DRIVE_HOLD_RAMP, seconds=seconds)

    async def reset_fault(self) -> Outcome:
        return await self._call_with_control(DRIVE_RESET)

    async def test_comm_loss(self, frequency_hz: float, silence_s: float | None) -> Json:
        """Start a communication-loss test; its result appears in ``comm_loss`` of the drive."""
        params = {"frequency_hz": frequency_hz, "silence_s": silence_s, **await self.arm("comm_loss_test")}
        return await self.call(COMM_LOSS_TEST, **params)

    async def write(self, values: Mapping[str, float | str], *, save: bool = False, force: bool = False) -> Outcome:
        return await self._call_with_control(PARAMETERS_WRITE, values=dict(values), save=save, force=force)

    def jog(self, frequency_hz: float | None, direction: Direction) -> RemoteJog:
        return RemoteJog(self, frequency_hz, direction)

    def assume_model(self) -> None:
        """Send each stop without the read that shows whether the station is of the plant's model."""
        self._assume_model = True

    async def stop(self, *, wait: bool = True) -> Outcome:
        return await self._stop("stop")

    async def coast(self, *, wait: bool = True) -> Outcome:
        return await self._stop("coast")

    async def quick_stop(self, *, wait: bool = True) -> Outcome:
        return await self._stop("quick_stop")

    async def _stop(self, mode: str) -> Outcome:
        """Stop without a lease. Raises OutcomeUnknown if the service is lost: nothing else could confirm the stop."""
        assumed = {"assume_model": True} if self._assume_model else {}
        with stop_errors(self.name):
            return parse_outcome(await self.call(DRIVE_STOP, how=mode, **assumed))

    async def _call_with_control(self, operation: Operation, **params: Any) -> Outcome:
        await self.take_control()
        return parse_outcome(await self.call(operation, **params))

    # --- control lease --------------------------------------------------------------------------------------------

    async def arm(self, purpose: str = "start") -> Json:
        """Take control; return the arm token that a start over HTTP needs."""
        await self.take_control()
        return (
            {} if self._client.is_local else {"arm_token": (await self.call(DRIVE_ARM, purpose=purpose))["arm_token"]}
        )

    async def take_control(self) -> None:
        """Take the control lease and renew it until ``close``. Raises ControlNotHeld."""
        if self._renewal is not None:
            return
        before = (await self.call(DRIVES_GET))["lease"]
        lease = (await self.call(LEASE_TAKE))["lease"]
        self._had_control_before = before is not None and before["session"] == lease["session"]
        self._renewal = asyncio.create_task(self._renew(), name="lease")

    async def _renew(self) -> None:
        while True:
            await asyncio.sleep(LEASE_RENEW_PERIOD_S)
            try:
                lease = await self.call(LEASE_RENEW)
            except ServiceUnavailable:
                continue
            self._report_request(lease.get("control_request"))

    def _report_request(self, request: Json | None) -> None:
        if request is not None and request["id"] != self._reported_request and self._on_control_request is not None:
            self._reported_request = request["id"]
            self._on_control_request(request)

    async def close(self) -> None:
        """Release the control lease, unless this session had it before."""
        renewal, self._renewal = self._renewal, None
        if renewal is None:
            return
        has_failed = renewal.done()
        renewal.cancel()
        await asyncio.gather(renewal, return_exceptions=True)
        if not self._had_control_before and not has_failed:
            try:
                await self.call(LEASE_RELEASE)
            except DrivebusError:
                return


class RemoteJog:
    """Jog of a remote drive, used as a ``JogSession``: the service ends it half a second after the last renewal."""

    def __init__(self, drive: RemoteDrive, frequency_hz: float | None, direction: Direction) -> None:
        self._drive, self._frequency_hz, self._direction = drive, frequency_hz, direction
        self._jog_id = ""
        self._renewal_due = asyncio.Event()
        self._renewal: asyncio.Task[None] | None = None
        self.start_outcome: Outcome | None = None
        self.stop_outcome: Outcome | None = None

    async def __aenter__(self) -> RemoteJog:
        """Begin the jog. Where that fails and the motor may be running, stop the drive before the error is raised."""
        with before_motion():
            params = {"direction": str(self._direction), **await self._drive.arm()}
        params |= {} if self._frequency_hz is None else {"frequency_hz": self._frequency_hz}
        try:
            jog = await self._drive.call(DRIVE_JOG, **params)
        except DrivebusError as error:
            if error.may_be_running is not False:
                await self._drive.stop()
            raise
        self._jog_id, self.start_outcome = jog["jog"], parse_outcome(jog)
        self._drive.note_start()
        self._renewal = asyncio.create_task(self._renew(), name="jog")
        return self

    def renew(self) -> None:
        """Request a renewal. Raises StartInhibited once the service has ended the jog."""
        if self._renewal is not None and self._renewal.done():
            self._renewal.result()
        self._renewal_due.set()

    async def _renew(self) -> None:
        """Send the renewals; requests during a transmission are merged into one."""
        while True:
            await self._renewal_due.wait()
            self._renewal_due.clear()
            await self._drive.call(DRIVE_JOG_RENEW, jog=self._jog_id)

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the jog. Raises OutcomeUnknown if the service is lost: nothing else could confirm the stop."""
        if self._renewal is not None:
            self._renewal.cancel()
            await asyncio.gather(self._renewal, return_exceptions=True)
        try:
            with stop_errors(self._drive.name):
                self.stop_outcome = parse_outcome(await self._drive.call(DRIVE_JOG_END, jog=self._jog_id))
        except NotFound:
            self.stop_outcome = await self._drive.stop()
