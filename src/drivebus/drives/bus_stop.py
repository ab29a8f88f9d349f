"""Stop every drive of a bus: by broadcast where the family has one, then one by one until each reports standstill.

Not an emergency stop: only a hard-wired STO or SS1 is.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives.drive import Drive
from drivebus.drives.operations.context import frame_exchange
from drivebus.drives.outcome import FrameExchange, Outcome, OutcomeStatus
from drivebus.errors import DrivebusError, StopUnconfirmed

BROADCAST_COUNT = 2  # a broadcast has no reply, and one may be lost


@dataclass(frozen=True, slots=True)
class StopReport:
    """Report of a bus stop: the broadcasts and the outcome of each drive.

    Times are seconds by ``Bus.now``.
    """

    started_at: float
    ended_at: float
    broadcasts: tuple[FrameExchange, ...]
    outcomes: tuple[tuple[int, Outcome], ...]  # address and outcome

    @property
    def acknowledged(self) -> tuple[int, ...]:
        """Addresses of drives that accepted the stop and cannot report standstill (DF800)."""
        return tuple(address for address, outcome in self.outcomes if outcome.status is OutcomeStatus.ACKNOWLEDGED)

    @property
    def unconfirmed(self) -> tuple[int, ...]:
        """Addresses of drives whose stop failed or is unknown; they must be checked."""
        return tuple(address for address, outcome in self.outcomes if not outcome.succeeded)

    @property
    def confirmed(self) -> bool:
        """Whether every drive reported standstill; False for a drive that only acknowledged the stop."""
        return not (self.acknowledged or self.unconfirmed)


async def stop_bus(bus: Bus, drives: Sequence[Drive]) -> StopReport:
    """Stop all drives of a bus. Starts stay inhibited until ``Bus.release_start``.

    Never raises for what the bus or a drive does; see ``unconfirmed``.
    """
    started_at = bus.now()
    bus.inhibit_start(None)
    broadcasts = await _broadcast(bus, drives)
    outcomes = await asyncio.gather(*(_stop(drive, len(drives)) for drive in drives))
    addresses = tuple(drive.address for drive in drives)
    return StopReport(started_at, bus.now(), broadcasts, tuple(zip(addresses, outcomes, strict=True)))


async def _broadcast(bus: Bus, drives: Sequence[Drive]) -> tuple[FrameExchange, ...]:
    """Send one broadcast per different frame.

    A stop that may start another model is broadcast only where every drive of the bus has answered as its model. One
    that is switched off may have been exchanged, and the new one may have any address.
    """
    requests: dict[bytes, BusRequest] = {}
    has_unproved_model = not all(drive.is_model_known for drive in drives)
    for drive in drives:
        must_wait = has_unproved_model and drive.profile.needs_model_check
        if must_wait or "broadcast_stop" not in drive.profile.capabilities:
            continue
        for request in drive.dialect.broadcast_stop():
            bus_request = BusRequest(
                station=drive.address,
                request=request,
                priority=RequestPriority.STOP,
            )
            requests.setdefault(drive.dialect.codec.encode_request(request), bus_request)
    sent: list[FrameExchange] = []
    for _ in range(BROADCAST_COUNT if requests else 0):
        for bus_request in requests.values():
            result = await bus.transact(bus_request)
            if result.sent:
                sent.append(frame_exchange(result))
    return tuple(sent)


async def _stop(drive: Drive, drive_count: int) -> Outcome:
    """Return the outcome of one stop, whatever it raises."""
    try:
        return await drive.stop_concurrently(drive_count)
    except StopUnconfirmed as error:
        outcome: Outcome = error.outcome
        return outcome
    except DrivebusError as error:
        return Outcome(status=OutcomeStatus.UNKNOWN, key=error.key, params=error.params)
    except KeyError:
        return Outcome(status=OutcomeStatus.UNKNOWN, key="bus.unregistered", params={"station": drive.address})
