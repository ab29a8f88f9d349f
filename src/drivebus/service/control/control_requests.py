"""Requests for control of a drive that another session controls. Pure: ``now`` (monotonic seconds) is an argument."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil

from drivebus.errors import NotFound, ServiceError
from drivebus.service.auth.actor import Actor
from drivebus.service.control.leases import ControlLeases
from drivebus.service.live.views import ControlRequestObject, ControlRequestState
from drivebus.service.runtime.utc_clock import UtcClock

CONTROL_REQUEST_TTL_S = 60.0  # a request without an answer expires after this time
CONTROL_REQUEST_INTERVAL_S = 30.0  # least time between two requests of one user for one drive
MAX_OPEN_REQUESTS = 20  # open at a time for one user; those of a selection of drives count as one
ENDED_REQUEST_TTL_S = 60.0  # an ended request stays readable for the session that made it


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlRequest:
    """Request of a session for control of one drive; ``answered_by`` is the user who granted or declined it."""

    id: str
    """The same for the requests of one selection of drives."""
    drive: str
    actor: Actor
    reason: str | None
    requested_at: float
    state: ControlRequestState = "open"
    answered_by: str | None = None
    ended_at: float | None = None

    @property
    def is_open(self) -> bool:
        return self.state == "open"

    @property
    def expires_at(self) -> float:
        return self.requested_at + CONTROL_REQUEST_TTL_S

    def view(self, clock: UtcClock) -> ControlRequestObject:
        return ControlRequestObject(
            id=self.id,
            user=self.actor.name,
            session=self.actor.session,
            reason=self.reason,
            state=self.state,
            requested_ms=clock.utc_ms(self.requested_at),
            expires_ms=clock.utc_ms(self.expires_at),
            answered_by=self.answered_by,
        )


class ControlRequests:
    """Newest request for control of each drive: an open one, or one that ended within ``ENDED_REQUEST_TTL_S``."""

    def __init__(self) -> None:
        self._requests: dict[str, ControlRequest] = {}
        self._requested_at: dict[tuple[str, str], float] = {}
        """Drive and user → time of the user's last request for it."""

    def get(self, drive: str) -> ControlRequest | None:
        """Return the newest request for a drive, open or ended; None without one."""
        return self._requests.get(drive)

    def find_open(self, drive: str) -> ControlRequest | None:
        """Return the open request for a drive; None without one."""
        request = self.get(drive)
        return request if request is not None and request.is_open else None

    def make(self, id: str, drive: str, actor: Actor, reason: str | None, now: float) -> ControlRequest:
        """Open a request. Raises ServiceError where one is open, or the user makes them too often."""
        other = self.find_open(drive)
        if other is not None:
            wait_s = max(1, ceil(other.expires_at - now))
            raise ServiceError("plant.control_requested_already", drive=drive, user=other.actor.name, wait_s=wait_s)
        last = self._requested_at.get((drive, actor.name))
        if last is not None and now - last < CONTROL_REQUEST_INTERVAL_S:
            wait_s = max(1, ceil(last + CONTROL_REQUEST_INTERVAL_S - now))
            raise ServiceError("plant.control_request_too_soon", drive=drive, wait_s=wait_s)
        open_ids = {each.id for each in self._requests.values() if each.is_open and each.actor.name == actor.name}
        if len(open_ids - {id}) >= MAX_OPEN_REQUESTS:
            raise ServiceError("plant.control_requests_too_many", limit=MAX_OPEN_REQUESTS)
        request = ControlRequest(id=id, drive=drive, actor=actor, reason=reason, requested_at=now)
        self._requests[drive] = request
        self._requested_at[drive, actor.name] = now
        return request

    def find_answerable(self, drive: str, id: str) -> ControlRequest:
        """Return the open request of this id. Raises NotFound: it has ended, or another one is open."""
        request = self.find_open(drive)
        if request is None or request.id != id:
            raise NotFound("plant.no_control_request", drive=drive)
        return request

    def end(self, request: ControlRequest, state: ControlRequestState, now: float, by: str | None = None) -> None:
        """End a request; ``by`` is the user who answered it."""
        self._requests[request.drive] = replace(request, state=state, answered_by=by, ended_at=now)

    def withdraw(self, drive: str, actor: Actor, now: float) -> None:
        """End the open request of this session. Raises NotFound without one."""
        request = self.find_open(drive)
        if request is None or not request.actor.is_same_session(actor):
            raise NotFound("plant.no_own_control_request", drive=drive)
        self.end(request, "withdrawn", now)

    def end_session(self, session: str, now: float) -> None:
        """End the open requests of a session that has ended: it could not use what is granted."""
        for request in tuple(self._requests.values()):
            if request.is_open and request.actor.session == session:
                self.end(request, "withdrawn", now)

    def expire(self, leases: ControlLeases, now: float) -> Iterator[ControlRequest]:
        """End the requests that are without subject or too old and yield them as ended; drop what is no longer kept.

        ``released``: no session has control any more. ``withdrawn``: the session that asked took control itself.
        """
        for request in tuple(self._requests.values()):
            state = _ended_state(request, leases, now)
            if state is not None:
                self.end(request, state, now)
                yield self._requests[request.drive]
            elif request.ended_at is not None and now - request.ended_at >= ENDED_REQUEST_TTL_S:
                del self._requests[request.drive]
        self._requested_at = {
            key: at for key, at in self._requested_at.items() if now - at < CONTROL_REQUEST_INTERVAL_S
        }

    def remove_drive(self, drive: str) -> None:
        """Drop the request for a drive that was removed from the plant. Idempotent."""
        self._requests.pop(drive, None)


def _ended_state(request: ControlRequest, leases: ControlLeases, now: float) -> ControlRequestState | None:
    """Return the state in which an open request ends now without an answer; None where it does not end."""
    if not request.is_open:
        return None
    lease = leases.get(request.drive, now)
    if lease is None:
        return "released"
    if lease.actor.is_same_session(request.actor):
        return "withdrawn"
    return "expired" if now >= request.expires_at else None
