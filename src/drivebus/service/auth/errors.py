"""What access says no to, each with the HTTP status that tells it. ``key`` is a sentence of the room ``access``."""

from __future__ import annotations

from typing import Any, ClassVar

from drivebus.errors import DrivebusError


class AuthError(DrivebusError):
    """Not let in, or not in that way."""

    status: ClassVar[int] = 403


class NotAuthenticated(AuthError):
    """No credential, or one that is forged, expired or ended."""

    status = 401


class AccessDenied(AuthError):
    """Known, and without the right; or a request that no page of ours would make."""


class Conflict(AuthError):
    """Not in this state: no administrator yet, or the last one would go."""

    status = 409


class ResourceNotFound(AuthError):
    """There is no such user, token or address."""

    status = 404


class InvalidInput(AuthError):
    """What was given can't be used: a weak password, an unknown right."""

    status = 422


class TooManyAttempts(AuthError):
    """Too many wrong passwords; ``retry_s`` tells when the next may be tried (S05)."""

    status = 429


class AuthUnavailable(AuthError):
    """The plant, or its record, can't be reached just now."""

    status = 503


def retry_after(error: DrivebusError) -> dict[str, str]:
    """The header that says when to come again, in whole seconds, where the error knows."""
    wait_s: Any = error.params.get("retry_s")
    return {} if wait_s is None else {"Retry-After": str(int(wait_s) + 1)}
