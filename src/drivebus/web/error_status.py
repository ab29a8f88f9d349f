"""HTTP status, headers and body of errors. The service knows no HTTP: this table is the only mapping."""

from __future__ import annotations

from typing import Any, ClassVar

from drivebus import errors
from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_to_json
from drivebus.service.auth.errors import (
    AuthError,
    AuthUnavailable,
    Conflict,
    InvalidInput,
    NotAuthenticated,
    ResourceNotFound,
    TooManyAttempts,
)
from drivebus.service.live.views import Json


class RequestError(AuthError):
    """Error that the web layer itself raises for a request, with its HTTP status."""

    status: ClassVar[int]


STATUS_BY_ERROR: tuple[tuple[type[DrivebusError], int], ...] = (
    (NotAuthenticated, 401),
    (Conflict, 409),
    (ResourceNotFound, 404),
    (InvalidInput, 422),
    (TooManyAttempts, 429),
    (AuthUnavailable, 503),
    (AuthError, 403),
    (errors.NotFound, 404),
    (errors.InvalidParameters, 422),
    (errors.PermissionDenied, 403),
    (errors.AuditUnavailable, 503),
    (errors.ServiceUnavailable, 503),
    (errors.ServiceError, 409),
    (errors.ConfigurationError, 422),
    (errors.LimitError, 422),
    (errors.CapabilityError, 422),
    (errors.OutcomeUnknown, 504),
    (errors.StopUnconfirmed, 504),
    (errors.DriveRejected, 502),
    (errors.TargetNotReached, 502),
    (errors.DriveError, 409),
    (errors.Expired, 409),
    (errors.Superseded, 409),
    (errors.NotPermitted, 409),
    (DrivebusError, 502),
)
"""The first match counts. The last row stands for failures of the bus or the drive: protocol, no reply, port."""


def http_status(error: DrivebusError) -> int:
    """Return the HTTP status of an error."""
    if isinstance(error, RequestError):
        return error.status
    return next(status for kind, status in STATUS_BY_ERROR if isinstance(error, kind))


def error_body(error: DrivebusError) -> Json:
    """Return an error as the API sends it: the service's form with the HTTP status."""
    return error_to_json(error) | {"status": http_status(error)}


def retry_after_header(error: DrivebusError) -> dict[str, str]:
    """Return the header ``Retry-After`` in whole seconds, if the error has a waiting time."""
    wait_s: Any = error.params.get("retry_s")
    return {} if wait_s is None else {"Retry-After": str(int(wait_s) + 1)}
