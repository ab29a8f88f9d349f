"""A drive of a service, with the same face as ``drives.Drive``, so that each verb is written once.

Commands take the drive's lease and hold it while the block lasts; a stop takes nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from drivebus.cli.service.client import Client
from drivebus.cli.service.said import outcome_of, reading_of, status_of
from drivebus.errors import DrivebusError, OutcomeUnknown, ServiceUnavailable

if TYPE_CHECKING:
    from drivebus.cli.service.jog import ServedJog
    from drivebus.drives.state import Direction, DriveStatus, Outcome
    from drivebus.profiles import DriveProfile
    from drivebus.reading import Reading

Json = dict[str, Any]

RENEW_S = 3.0
"""A lease lasts ten seconds."""
FRESH_S, LOOK_S = 3.0, 0.1
"""After a start a look waits so long for a state that is newer than it; between two looks."""


class ServedBus:
    """What the verbs ask of a bus beside its drive."""

    @staticmethod
    def now() -> float:
        return time.monotonic()

    @staticmethod
    def health(address: int) -> Any:
        """Another master on the line is told by the service itself, as the reason of a refusal."""
        return SimpleNamespace(foreign_master=False)


class ServedDrive:
    """One drive, by its name in the plant."""

    def __init__(self, client: Client, name: str, address: int, profile: DriveProfile) -> None:
        self._client, self.name, self.address, self.profile = client, name, address, profile
        self._renewing: asyncio.Task[None] | None = None
        self._was_ours = False
        self._moved_at: float | None = None

    async def ask(self, operation: str, **params: Any) -> Json:
        return await self._client.call(operation, {"drive": self.name, **params})

    # --- looking ------------------------------------------------------------------------------------------------

    async def status(self) -> DriveStatus:
        """Raises NotOwner once the lease of an attached command is lost: somebody else commands the drive now."""
        if self._renewing is not None and self._renewing.done():
            self._renewing.result()
        now = ServedBus.now()
        view = await self.ask("drives.get")
        while self._is_older(view, now) and now - (self._moved_at or now) < FRESH_S:
            await asyncio.sleep(LOOK_S)
            now = ServedBus.now()
            view = await self.ask("drives.get")
        return status_of(view, now)

    def _is_older(self, view: Json, now: float) -> bool:
        """Its state was read before the drive was started: it still tells of the time before."""
        age_s = view["state_age_s"]
        return self._moved_at is not None and (age_s is None or now - age_s < self._moved_at)

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        found = await self.ask("parameters.read", names=list(names))
        return {name: reading_of(one, ServedBus.now()) for name, one in found["parameters"].items()}

    async def if_host_dies(self) -> Any:
        """As the service has read it from the drive."""
        found = (await self.ask("drives.get"))["host_dies"]
        text = found["text"] or {}
        return SimpleNamespace(trips=found["kind"] == "trips", text=lambda language: text.get(language, ""))

    # --- commands -----------------------------------------------------------------------------------------------

    async def run(self, frequency_hz: float, direction: Direction | None = None, wait: bool = False) -> Outcome:
        given: Json = {"frequency_hz": frequency_hz} | ({"direction": str(direction)} if direction else {})
        outcome = outcome_of(await self.ask("drive.run", **given, **await self.armed()))
        self._moved_at = ServedBus.now()
        return outcome

    async def set_frequency(self, frequency_hz: float) -> Outcome:
        return await self._owned("drive.set_frequency", frequency_hz=frequency_hz)

    async def reset_fault(self) -> Outcome:
        return await self._owned("drive.reset")

    async def write(self, values: Mapping[str, float], save: bool = False) -> Outcome:
        return await self._owned("parameters.write", values=dict(values), save=save)

    def jog(self, frequency_hz: float | None, direction: Direction, lease_s: float) -> ServedJog:
        from drivebus.cli.service.jog import ServedJog

        return ServedJog(self, frequency_hz, direction)

    async def stop(self, wait: bool = True) -> Outcome:
        return await self._stopped("stop")

    async def coast(self, wait: bool = True) -> Outcome:
        return await self._stopped("coast")

    async def _stopped(self, how: str) -> Outcome:
        """No lease, no second step. Where the service is gone, so is all that it could confirm."""
        try:
            return outcome_of(await self.ask("drive.stop", how=how))
        except ServiceUnavailable as error:
            raise OutcomeUnknown("service.not_stopped", drive=self.name, why=error) from error

    async def _owned(self, operation: str, **params: Any) -> Outcome:
        await self.own()
        return outcome_of(await self.ask(operation, **params))

    # --- who may ------------------------------------------------------------------------------------------------

    async def armed(self) -> Json:
        """The lease, and for a start from afar the first of its two steps."""
        await self.own()
        return {} if self._client.is_local else {"arm": (await self.ask("drive.arm"))["arm"]}

    async def own(self) -> None:
        """Take the drive, and keep it until ``close``. Raises NotOwner."""
        if self._renewing is not None:
            return
        before = (await self.ask("drives.get"))["lease"]
        lease = (await self.ask("lease.take"))["lease"]
        self._was_ours = before is not None and before["session"] == lease["session"]
        self._renewing = asyncio.create_task(self._renew(), name="lease")

    async def _renew(self) -> None:
        while True:
            await asyncio.sleep(RENEW_S)
            try:
                await self.ask("lease.renew")
            except ServiceUnavailable:
                continue

    async def close(self) -> None:
        """Give the drive back, unless another program of ours had it before."""
        renewing, self._renewing = self._renewing, None
        if renewing is None:
            return
        lost = renewing.done()
        renewing.cancel()
        await asyncio.gather(renewing, return_exceptions=True)
        if not self._was_ours and not lost:
            try:
                await self.ask("lease.release")
            except DrivebusError:
                return
