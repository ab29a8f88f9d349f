"""Packages of the optional extras of the installation: ``cli``, ``server`` and ``tui``."""

from __future__ import annotations

from importlib.util import find_spec

EXTRA_PACKAGES = {
    "cli": ("click", "rich"),
    "server": ("argon2", "fastapi", "httptools", "prometheus_client", "uvicorn", "websockets"),
    "tui": ("textual",),
}


def require_extra(extra: str) -> None:
    """Check that the packages of an extra are installed, before anything is opened. Raises ConfigurationError."""
    missing = [name for name in EXTRA_PACKAGES[extra] if find_spec(name) is None]
    if missing:
        from drivebus.errors import ConfigurationError

        raise ConfigurationError(f"cli.extra.{extra}", missing=tuple(missing))
