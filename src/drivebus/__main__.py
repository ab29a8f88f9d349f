"""``python -m drivebus``: the command line."""

from drivebus.cli.main import main

main()
