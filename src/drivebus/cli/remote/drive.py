"""A drive of a service, with the same face as ``drives.Drive``, so that each verb is written once.

Commands take the drive's lease and hold it while the block lasts; a stop takes nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from types import SimpleNamespace, TracebackType
from typing import TYPE_CHECKING, Any

from drivebus.cli.remote.client import RemoteClient
from drivebus.cli.remote.convert import parse_outcome, parse_reading, parse_status, reading_time
from drivebus.errors import DrivebusError, NotFound, OutcomeUnknown, ServiceUnavailable
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.drives.outcome import Outcome
    from drivebus.drives.state import Direction, DriveStatus
    from drivebus.profiles import DriveProfile
    from drivebus.values import Reading

LEASE_RENEW_PERIOD_S = 3.0
"""A lease lasts ten seconds."""
FRESH_STATE_TIMEOUT_S, STATE_POLL_PERIOD_S = 3.0, 0.1
"""After a start a look waits so long for a state that is newer than it; between two looks."""


class RemoteBus:
    """What the verbs ask of a bus beside its drive."""

    @staticmethod
    def now() -> float:
        return time.monotonic()

    @staticmethod
    def health(address: int) -> Any:
        """Another master on the line is told by the service itself, as the reason of a refusal."""
        return SimpleNamespace(foreign_master=False)


class RemoteDrive:
    """One drive, by its name in the plant."""

    def __init__(self, client: RemoteClient, name: str, address: int, profile: DriveProfile) -> None:
        self._client, self.name, self.address, self.profile = client, name, address, profile
        self._renewal: asyncio.Task[None] | None = None
        self._had_control_before = False
        self._started_at: float | None = None

    async def call(self, operation: str, **params: Any) -> Json:
        return await self._client.call(operation, {"drive": self.name, **params})

    # --- looking ------------------------------------------------------------------------------------------------

    async def status(self) -> DriveStatus:
        """Raises ControlNotHeld once the lease of an attached command is lost: somebody else commands the drive now."""
        if self._renewal is not None and self._renewal.done():
            self._renewal.result()
        now = RemoteBus.now()
        view = await self.call("drives.get")
        while self._predates_start(view, now) and now - (self._started_at or now) < FRESH_STATE_TIMEOUT_S:
            await asyncio.sleep(STATE_POLL_PERIOD_S)
            now = RemoteBus.now()
            view = await self.call("drives.get")
        return parse_status(view, now)

    def _predates_start(self, view: Json, now: float) -> bool:
        """Its state was read before the drive was started: it still tells of the time before."""
        state_at = reading_time(view["state_time_ms"], view["time_ms"], now)
        return self._started_at is not None and (state_at is None or state_at < self._started_at)

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        found = await self.call("parameters.read", names=list(names))
        return {name: parse_reading(one) for name, one in found["parameters"].items()}

    async def comm_loss_behaviour(self) -> Any:
        """As the service has read it from the drive."""
        found = (await self.call("drives.get"))["comm_loss"]
        text = found["text"] or {}
        return SimpleNamespace(
            stops_on_comm_loss=found["kind"] == "trips", text=lambda language: text.get(language, "")
        )

    # --- commands -----------------------------------------------------------------------------------------------

    async def run(self, frequency_hz: float, direction: Direction | None = None, wait: bool = False) -> Outcome:
        given: Json = {"frequency_hz": frequency_hz} | ({"direction": str(direction)} if direction else {})
        outcome = parse_outcome(await self.call("drive.run", **given, **await self.arm()))
        self._started_at = RemoteBus.now()
        return outcome

    async def set_frequency(self, frequency_hz: float) -> Outcome:
        return await self._call_with_control("drive.set_frequency", frequency_hz=frequency_hz)

    async def reset_fault(self) -> Outcome:
        return await self._call_with_control("drive.reset")

    async def write(self, values: Mapping[str, float], save: bool = False) -> Outcome:
        return await self._call_with_control("parameters.write", values=dict(values), save=save)

    def jog(self, frequency_hz: float | None, direction: Direction, lease_s: float) -> RemoteJog:
        return RemoteJog(self, frequency_hz, direction)

    async def stop(self, wait: bool = True) -> Outcome:
        return await self._stop("stop")

    async def coast(self, wait: bool = True) -> Outcome:
        return await self._stop("coast")

    async def _stop(self, how: str) -> Outcome:
        """No lease, no second step. Where the service is gone, so is all that it could confirm."""
        try:
            return parse_outcome(await self.call("drive.stop", how=how))
        except ServiceUnavailable as error:
            raise OutcomeUnknown("service.not_stopped", drive=self.name, why=error) from error

    async def _call_with_control(self, operation: str, **params: Any) -> Outcome:
        await self.take_control()
        return parse_outcome(await self.call(operation, **params))

    # --- who may ------------------------------------------------------------------------------------------------

    async def arm(self) -> Json:
        """The lease, and for a start from afar the first of its two steps."""
        await self.take_control()
        return {} if self._client.is_local else {"arm_token": (await self.call("drive.arm"))["arm_token"]}

    async def take_control(self) -> None:
        """Take the drive, and keep it until ``close``. Raises ControlNotHeld."""
        if self._renewal is not None:
            return
        before = (await self.call("drives.get"))["lease"]
        lease = (await self.call("lease.take"))["lease"]
        self._had_control_before = before is not None and before["session"] == lease["session"]
        self._renewal = asyncio.create_task(self._renew(), name="lease")

    async def _renew(self) -> None:
        while True:
            await asyncio.sleep(LEASE_RENEW_PERIOD_S)
            try:
                await self.call("lease.renew")
            except ServiceUnavailable:
                continue

    async def close(self) -> None:
        """Give the drive back, unless another program of ours had it before."""
        renewing, self._renewal = self._renewal, None
        if renewing is None:
            return
        lost = renewing.done()
        renewing.cancel()
        await asyncio.gather(renewing, return_exceptions=True)
        if not self._had_control_before and not lost:
            try:
                await self.call("lease.release")
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
        given = {"direction": str(self._direction), **await self._drive.arm()}
        given |= {} if self._frequency_hz is None else {"frequency_hz": self._frequency_hz}
        found = await self._drive.call("drive.jog", **given)
        self._jog_id, self.start_outcome = found["jog"], parse_outcome(found)
        self._renewal = asyncio.create_task(self._renew(), name="jog")
        return self

    def renew(self) -> None:
        """Request a renewal. Raises StartInhibited once the service has ended the jog."""
        if self._renewal is not None and self._renewal.done():
            self._renewal.result()
        self._renewal_due.set()

    async def _renew(self) -> None:
        """Send the renewals; requests that come while one is being sent are sent as one."""
        while True:
            await self._renewal_due.wait()
            self._renewal_due.clear()
            await self._drive.call("drive.jog_renew", jog=self._jog_id)

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._renewal is not None:
            self._renewal.cancel()
            await asyncio.gather(self._renewal, return_exceptions=True)
        try:
            self.stop_outcome = parse_outcome(await self._drive.call("drive.jog_end", jog=self._jog_id))
        except NotFound:
            self.stop_outcome = await self._drive.stop()
