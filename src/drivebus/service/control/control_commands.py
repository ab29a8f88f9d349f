"""Control of drives by users: leases, and requests to the session that has one. None of it sends a frame."""

from __future__ import annotations

from drivebus.errors import ControlNotHeld, DrivebusError, NotFound, ServiceError
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.control import (
    CONTROL_REQUEST_DECLINE,
    CONTROL_REQUEST_GRANT,
    CONTROL_REQUEST_MAKE,
    CONTROL_REQUEST_WITHDRAW,
    CONTROL_REQUESTS_MAKE,
    CONTROL_REQUESTS_WITHDRAW,
    LEASE_RELEASE,
    LEASE_RENEW,
    LEASE_TAKE,
    ControlAnswerParams,
    ControlRequestParams,
    ControlRequestsParams,
)
from drivebus.service.api.operations.drives import DriveParams
from drivebus.service.api.operations.selections import SelectionParams
from drivebus.service.auth.actor import Actor
from drivebus.service.control.control_requests import ControlRequest
from drivebus.service.control.leases import LEASE_TTL_S
from drivebus.service.control.selections import DONE, UNCHANGED
from drivebus.service.live.views import record_json
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json


class ControlCommands:
    """Handlers of ``lease.*``, ``control_request.*`` and ``control_requests.*``."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    # --- leases -------------------------------------------------------------------------------------------------

    @handles(LEASE_TAKE)
    async def take_lease(self, params: DriveParams, actor: Actor) -> Json:
        """Take control. The event of a takeover names the user who had asked for control, too."""
        runtime, now = self.plant.drive_runtime(params.drive), self.plant.now()
        taken = self.plant.leases.take(runtime.id, actor, now)
        request = self.plant.control_requests.find_open(runtime.id)
        if taken is not None and request is not None and not request.actor.is_same_session(actor):
            self.plant.publish_event(
                "lease",
                runtime.id,
                "plant.lease_taken_requested",
                actor=actor.name,
                owner=taken.actor.name,
                user=request.actor.name,
            )
        elif taken is not None:
            self.plant.publish_event("lease", runtime.id, "plant.lease_taken", actor=actor.name, owner=taken.actor.name)
        return self._lease_json(runtime)

    @handles(LEASE_RENEW)
    async def renew_lease(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        self.plant.leases.renew(runtime.id, actor, self.plant.now())
        return self._lease_json(runtime)

    @handles(LEASE_RELEASE)
    async def release_lease(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        self.plant.leases.release(runtime.id, actor, self.plant.now())
        return {}

    def _lease_json(self, runtime: DriveRuntime) -> Json:
        """Return the lease of a drive, with the open request for its control."""
        lease = self.plant.leases.get(runtime.id, self.plant.now())
        request = self.plant.control_requests.find_open(runtime.id)
        return {
            "lease": None if lease is None else record_json(lease.view(self.plant.clock)),
            "ttl_s": LEASE_TTL_S,
            "control_request": None if request is None else record_json(request.view(self.plant.clock)),
        }

    # --- requests -----------------------------------------------------------------------------------------------

    @handles(CONTROL_REQUEST_MAKE)
    async def make_request(self, params: ControlRequestParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        self._make_request(runtime, params.reason, self.plant.command_id("request"), actor)
        return self._lease_json(runtime)

    def _make_request(self, runtime: DriveRuntime, reason: str | None, id: str, actor: Actor) -> None:
        """Ask the session that has control. Raises ServiceError where there is none, or it is the actor's own.

        Raises ControlNotHeld where the actor's session has just ended.
        """
        now = self.plant.now()
        if self.plant.leases.has_ended(actor.session, now):  # while the request was recorded
            raise ControlNotHeld("plant.session_has_ended", drive=runtime.id)
        lease = self.plant.leases.get(runtime.id, now)
        if lease is None:
            raise ServiceError("plant.control_is_free", drive=runtime.id)
        if lease.actor.is_same_session(actor):
            raise ServiceError("plant.control_is_own", drive=runtime.id)
        self.plant.control_requests.make(id, runtime.id, actor, reason, now)
        key = "plant.control_requested" if reason is None else "plant.control_requested_for"
        why = {} if reason is None else {"reason": reason}
        self.plant.publish_event("lease", runtime.id, key, actor=actor.name, owner=lease.actor.name, **why)

    @handles(CONTROL_REQUEST_GRANT)
    async def grant_request(self, params: ControlAnswerParams, actor: Actor) -> Json:
        """Hand control over to the session that asks; the drive goes on as it is. Raises ControlNotHeld, NotFound."""
        request = self._find_answerable(params, actor)
        now = self.plant.now()
        self.plant.leases.hand_over(request.drive, actor, request.actor, now)
        self.plant.control_requests.end(request, "granted", now, actor.name)
        self._publish_answer(request, "plant.control_granted", actor)
        return {}

    @handles(CONTROL_REQUEST_DECLINE)
    async def decline_request(self, params: ControlAnswerParams, actor: Actor) -> Json:
        """Keep control. Raises ControlNotHeld, NotFound."""
        request = self._find_answerable(params, actor)
        self.plant.control_requests.end(request, "declined", self.plant.now(), actor.name)
        self._publish_answer(request, "plant.control_declined", actor)
        return {}

    @handles(CONTROL_REQUEST_WITHDRAW)
    async def withdraw_request(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        self.plant.control_requests.withdraw(runtime.id, actor, self.plant.now())
        return {}

    @handles(CONTROL_REQUESTS_MAKE)
    async def make_requests(self, params: ControlRequestsParams, actor: Actor) -> Json:
        """Ask for each drive that another session controls, with one id for all requests."""
        id, outcomes = self.plant.command_id("request"), {}
        for runtime in self.plant.selected(params.drives, params.group, everything=params.all):
            if self.plant.leases.controls(runtime.id, actor, self.plant.now()):
                outcomes[runtime.id] = UNCHANGED
                continue
            try:
                self._make_request(runtime, params.reason, id, actor)
            except DrivebusError as error:
                outcomes[runtime.id] = error_to_json(error)
            else:
                outcomes[runtime.id] = DONE
        return {"outcomes": outcomes}

    @handles(CONTROL_REQUESTS_WITHDRAW)
    async def withdraw_requests(self, params: SelectionParams, actor: Actor) -> Json:
        outcomes = {}
        for runtime in self.plant.selected(params.drives, params.group, everything=params.all):
            try:
                self.plant.control_requests.withdraw(runtime.id, actor, self.plant.now())
            except NotFound:
                outcomes[runtime.id] = UNCHANGED
            else:
                outcomes[runtime.id] = DONE
        return {"outcomes": outcomes}

    def _find_answerable(self, params: ControlAnswerParams, actor: Actor) -> ControlRequest:
        """Return the request that the actor, who has control, answers. Raises NotFound, ControlNotHeld."""
        runtime = self.plant.drive_runtime(params.drive)
        self.plant.leases.require_answerable(runtime.id, actor, self.plant.now())
        return self.plant.control_requests.find_answerable(runtime.id, params.request)

    def _publish_answer(self, request: ControlRequest, key: str, actor: Actor) -> None:
        self.plant.publish_event("lease", request.drive, key, actor=actor.name, user=request.actor.name)

    def expire_requests(self) -> None:
        """End the requests without an answer in time or without a holder; called by the supervision cycle."""
        for request in self.plant.control_requests.expire(self.plant.leases, self.plant.now()):
            if request.state == "expired":
                self.plant.publish_event(
                    "lease", request.drive, "plant.control_request_expired", user=request.actor.name
                )
