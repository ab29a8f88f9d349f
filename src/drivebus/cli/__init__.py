"""The bench command line: one module a verb under ``verbs``; every import that costs time waits inside its verb."""

from __future__ import annotations


def main() -> None:
    """Entry point of the ``drivebus`` command."""
    from drivebus.cli.root import cli

    cli(prog_name="drivebus")
