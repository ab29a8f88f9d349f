"""Command line of a child process that runs a module."""

from __future__ import annotations

import sys


def module_command(module: str, *arguments: str) -> tuple[str, ...]:
    """Return the command of a child process that runs a module with this interpreter.

    ``-P`` keeps the working directory off its import path: others may write there, as in /tmp.
    """
    return (sys.executable, "-P", "-m", module, *arguments)
