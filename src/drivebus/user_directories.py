"""Directories of the user, also of one without a home, such as a number without an account in a container."""

from __future__ import annotations

import os
from pathlib import Path


def home_directory() -> Path:
    """Return the user's home; the root directory where there is none: no missing home prevents a stop."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")


def user_config_directory() -> Path:
    """Return ``$XDG_CONFIG_HOME/drivebus``, else ``~/.config/drivebus``."""
    return _directory(os.environ.get("XDG_CONFIG_HOME"), ".config")


def user_state_directory() -> Path:
    """Return ``$XDG_STATE_HOME/drivebus``, else ``~/.local/state/drivebus``; on Windows in ``%LOCALAPPDATA%``."""
    return _directory(os.environ.get("XDG_STATE_HOME") or os.environ.get("LOCALAPPDATA"), ".local/state")


def expand_home(path: str | Path) -> Path:
    """Expand ``~`` at the beginning of a path; a path in a home that is not known stays as it is."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def _directory(base: str | None, below_home: str) -> Path:
    is_absolute = base is not None and Path(base).is_absolute()  # a relative one would depend on the working directory
    return (Path(str(base)) if is_absolute else home_directory() / below_home) / "drivebus"
