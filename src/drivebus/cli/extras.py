"""What a bare install leaves out: the packages of the page and of its users (the extra ``server``)."""

from __future__ import annotations

from importlib.util import find_spec

SERVER_PACKAGES = ("argon2", "fastapi", "httptools", "prometheus_client", "uvicorn", "websockets")


def require_server() -> None:
    """Before anything is opened. Raises ConfigurationError where one of them is not installed."""
    missing = [name for name in SERVER_PACKAGES if find_spec(name) is None]
    if missing:
        from drivebus.errors import ConfigurationError

        raise ConfigurationError("serve.no_server", missing=", ".join(missing))
