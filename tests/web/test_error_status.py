"""HTTP status and headers of the service's errors."""

from __future__ import annotations

import pytest

from drivebus.service.auth.errors import (
    AccessDenied,
    AuthError,
    AuthUnavailable,
    Conflict,
    InvalidInput,
    NotAuthenticated,
    ResourceNotFound,
    TooManyAttempts,
)
from drivebus.web.error_status import error_body, retry_after_header


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        (AuthError, 403),
        (NotAuthenticated, 401),
        (AccessDenied, 403),
        (Conflict, 409),
        (ResourceNotFound, 404),
        (InvalidInput, 422),
        (TooManyAttempts, 429),
        (AuthUnavailable, 503),
    ],
)
def test_each_authentication_error_has_its_status(kind: type[AuthError], status: int) -> None:
    assert error_body(kind("access.forbidden", right="view"))["status"] == status


def test_retry_after_is_never_shorter_than_the_delay() -> None:
    waits = [retry_after_header(TooManyAttempts("access.too_many", retry_s=retry_s)) for retry_s in (0.1, 1.9, 2.0)]
    assert waits == [{"Retry-After": "1"}, {"Retry-After": "2"}, {"Retry-After": "3"}]
    assert retry_after_header(AccessDenied("access.csrf")) == {}
