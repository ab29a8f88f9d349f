"""Windows and macOS: no POSIX module is imported at the start, nor by a command without a serial port."""

from __future__ import annotations

import subprocess
import sys

import pytest

ONLY_POSIX = ("termios", "fcntl", "tty", "pty", "resource", "grp", "pwd", "curses")
WITHOUT_POSIX_SCRIPT = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ONLY_POSIX}:
            raise ImportError("not on this system: " + name)
sys.meta_path.insert(0, Missing())
for name in {ONLY_POSIX}:
    sys.modules.pop(name, None)
sys.argv = ["drivebus", *sys.argv[1:]]
from drivebus.cli.main import main
main()
"""


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["models"],
        ["decode", "--model", "vc660", "01 08 00 00 5A A5 1A D0"],
        ["status", "sim://vc660@1", "--model", "vc660", "--address", "1"],
        ["run", "tcp://192.0.2.1:4001", "--model", "c320", "--address", "1", "--frequency", "5", "--dry-run"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_command_works_without_posix_modules(arguments: list[str]) -> None:
    command = [sys.executable, "-c", WITHOUT_POSIX_SCRIPT, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
