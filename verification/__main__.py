"""``python -m verification``: the same as ``drivebus lab``."""

from verification.cli import command

command(prog_name="python -m verification")
