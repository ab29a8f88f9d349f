"""Stop every drive of a bus: by broadcast where the family has one, then one by one until each reports standstill.

Not an emergency stop: only a hard-wired STO or SS1 is.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.drive import Drive
from drivebus.drives.operations.exchange_log import frame_exchange
from drivebus.drives.outcome import FrameExchange, Outcome, OutcomeStatus
from drivebus.drives.stop_supervisor import JointStops
from drivebus.errors import DrivebusError, PortError, StopUnconfirmed

BROADCAST_COUNT = 2  # a broadcast has no reply, and one may be lost
MAX_SWEEPS = 3  # of each round: the first one, and further ones of the addresses that a lost port left out
PORT_RETURN_POLLS = 20  # checks whether a lost port is back: with their pauses 2 s, as long as a stop without progress
PORT_POLL_INTERVAL_S = 0.1  # pause between two such checks
EVIDENCE_OF_PRESENCE = {"late", "foreign", "duplicate"}  # frames of a station outside its own transaction, as counted


@dataclass(frozen=True, slots=True, kw_only=True)
class StopReport:
    """Report of a bus stop: the broadcasts and the outcome of each drive.

    Times are seconds by ``Bus.now``.
    """

    started_at: float
    ended_at: float
    broadcasts: tuple[FrameExchange, ...]
    outcomes: tuple[tuple[int, Outcome], ...]  # address and outcome
    absent: tuple[int, ...] = ()
    """Addresses without a reply, where ``stop_all_addresses`` looked for drives."""
    lost: tuple[int, ...] = ()
    """Addresses without a reply where the port lost a stop or its repetition: a drive may run at each of them."""

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
        """Whether every drive reported standstill; False for a drive that only acknowledged the stop.

        Also False where drives were looked for and none replied: the cable may be broken.
        """
        found_none = bool(self.absent) and not self.outcomes
        return not (self.acknowledged or self.unconfirmed or self.lost or found_none)


async def stop_bus(bus: Bus, drives: Sequence[Drive]) -> StopReport:
    """Stop all drives of a bus. Starts stay inhibited until ``Bus.release_start``.

    Never raises for what the bus or a drive does; see ``unconfirmed``.
    """
    started_at = bus.now()
    bus.inhibit_start(None)
    broadcasts, joint = await _broadcast(bus, drives), JointStops()
    outcomes = await asyncio.gather(*(_stop(drive, joint) for drive in drives))
    addresses = tuple(drive.address for drive in drives)
    return StopReport(
        started_at=started_at,
        ended_at=bus.now(),
        broadcasts=broadcasts,
        outcomes=tuple(zip(addresses, outcomes, strict=True)),
    )


async def stop_all_addresses(
    bus: Bus, drives: Sequence[Drive], on_progress: Callable[[Drive, float], None] | None = None
) -> StopReport:
    """Stop a bus whose addresses are not known: ``drives`` has one for every address at which a drive may be.

    Each address is sent a stop at once, and the drives that reply, in time or late, are stopped as by ``stop_bus``; the
    other addresses are sent it once more, those that a lost port left out once it is back within 2 s. ``on_progress``
    gets each drive that was sent a frame, and the share of this round's drives so far (above 0, at most 1).
    """
    started_at, reports = bus.now(), list[StopReport]()
    lateness_s = max((drive.dialect.station_config.timing.max_reply_lateness_s for drive in drives), default=0.0)
    lost = await _stop_found_drives(bus, drives, reports, on_progress)
    lost += await _stop_found_drives(bus, _silent_drives(drives, lost, reports), reports, on_progress)
    await asyncio.sleep(lateness_s)
    reports.append(await stop_bus(bus, _late_drives(bus, drives, reports)))
    lost_addresses = {drive.address for drive in _unreported_drives(lost, reports)}
    return StopReport(
        started_at=started_at,
        ended_at=reports[-1].ended_at,
        broadcasts=tuple(exchange for report in reports for exchange in report.broadcasts),
        outcomes=tuple(sorted((each for report in reports for each in report.outcomes), key=itemgetter(0))),
        absent=tuple(
            each.address for each in _unreported_drives(drives, reports) if each.address not in lost_addresses
        ),
        lost=tuple(sorted(lost_addresses)),
    )


async def _stop_found_drives(
    bus: Bus,
    drives: Sequence[Drive],
    reports: list[StopReport],
    on_progress: Callable[[Drive, float], None] | None,
) -> list[Drive]:
    """Send one stop to each address, and stop the drives that reply, also those that reply late.

    Append the reports of these stops; return the drives whose stop a port lost that did not return.
    """
    lost = list(drives)
    for _ in range(MAX_SWEEPS):
        bus.inhibit_start(None)
        started_at, broadcasts = bus.now(), await _broadcast(bus, lost)
        reports.append(StopReport(started_at=started_at, ended_at=bus.now(), broadcasts=broadcasts, outcomes=()))
        present, lost = await _sweep(bus, lost, on_progress)
        reports.append(await stop_bus(bus, present))
        is_open = await _is_open_soon(bus)
        reports.append(await stop_bus(bus, _late_drives(bus, drives, reports)))
        lost = _unreported_drives(lost, reports)
        if not lost or not is_open:
            break
    return lost


def _silent_drives(drives: Sequence[Drive], lost: Sequence[Drive], reports: Iterable[StopReport]) -> list[Drive]:
    """Return the drives that did not reply to a stop: on a disturbed bus it may be lost, or its reply.

    Those that are only read first are left out: a second read waits for the quarantine of its address.
    """
    return [
        drive
        for drive in _unreported_drives(drives, reports)
        if drive not in lost and drive.dialect.model_check() is None
    ]


def _unreported_drives(drives: Sequence[Drive], reports: Iterable[StopReport]) -> list[Drive]:
    reported = {address for report in reports for address, _ in report.outcomes}
    return [drive for drive in drives if drive.address not in reported]


async def _sweep(
    bus: Bus, drives: Sequence[Drive], on_progress: Callable[[Drive, float], None] | None
) -> tuple[list[Drive], list[Drive]]:
    """Send one stop to each address; return the drives that replied, and those whose stop the port lost.

    Where a stop waits until its station answered as this model, each address is read instead.
    """
    present, lost = list[Drive](), list[Drive]()
    for number, drive in enumerate(drives, 1):
        check = drive.dialect.model_check()
        request = BusRequest(
            station=drive.address,
            request=drive.dialect.stop(StopMode.STOP)[0] if check is None else check,
            priority=RequestPriority.STOP if check is None else RequestPriority.STOP_READ,
        )
        result = await bus.transact(request)
        if result.received:
            present.append(drive)
        elif isinstance(result.error, PortError):
            lost.append(drive)
        if on_progress is not None:
            on_progress(drive, number / len(drives))
    return present, lost


def _late_drives(bus: Bus, drives: Sequence[Drive], reports: Iterable[StopReport]) -> list[Drive]:
    """Return the drives that are in no report although frames of them were received outside their transactions."""
    stations = bus.statistics().stations
    return [
        drive
        for drive in _unreported_drives(drives, reports)
        if EVIDENCE_OF_PRESENCE & stations[drive.address].counters.keys()
    ]


async def _is_open_soon(bus: Bus) -> bool:
    """Return whether the port is open, now or after a short wait for its return."""
    for _ in range(PORT_RETURN_POLLS):
        if bus.is_open:
            break
        await asyncio.sleep(PORT_POLL_INTERVAL_S)
    return bus.is_open


async def _broadcast(bus: Bus, drives: Sequence[Drive]) -> tuple[FrameExchange, ...]:
    """Send one broadcast per different frame.

    A stop that may start another model is broadcast only where every drive of the bus has answered as its model. One
    that is switched off may have been exchanged, and the new one may have any address.
    """
    requests: dict[bytes, BusRequest] = {}
    has_unconfirmed_model = not all(drive.is_model_known for drive in drives)
    for drive in drives:
        must_wait = has_unconfirmed_model and drive.profile.needs_model_check
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


async def _stop(drive: Drive, joint: JointStops) -> Outcome:
    """Return the outcome of one stop, whatever it raises."""
    try:
        return await drive.stop(joint=joint)
    except StopUnconfirmed as error:
        outcome: Outcome = error.outcome
        return outcome
    except DrivebusError as error:
        return Outcome(status=OutcomeStatus.UNKNOWN, key=error.key, params=error.params)
    except KeyError:
        return Outcome(status=OutcomeStatus.UNKNOWN, key="bus.unregistered", params={"station": drive.address})
