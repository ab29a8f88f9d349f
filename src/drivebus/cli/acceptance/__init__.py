"""``drivebus lab hardware``: what only real wires, adapters and drives can show, step by step, with a dated report."""

from drivebus.cli.acceptance.command import command

__all__ = ["command"]
