"""``python -m drivebus.lab``: the same as ``drivebus lab``."""

from drivebus.lab.verbs import command

command(prog_name="python -m drivebus.lab")
