"""Errors of authentication and authorization. ``key`` is a message of the catalogue ``auth``."""

from __future__ import annotations

from drivebus.errors import DrivebusError


class AuthError(DrivebusError):
    """A request was refused before it reached the plant."""


class NotAuthenticated(AuthError):
    """The credential is missing, wrong, expired or ended."""


class AccessDenied(AuthError):
    """The credential is valid but lacks the right, or the request came from a foreign page."""


class Conflict(AuthError):
    """The request does not fit the state: no administrator yet, or the last one would be removed."""


class ResourceNotFound(AuthError):
    """There is no such user, token or address."""


class InvalidInput(AuthError):
    """A value cannot be used: a weak password, an unknown right."""


class TooManyAttempts(AuthError):
    """Too many wrong passwords. ``retry_s`` is the waiting time in seconds."""


class AuthUnavailable(AuthError):
    """The service or its audit trail cannot be reached now."""
