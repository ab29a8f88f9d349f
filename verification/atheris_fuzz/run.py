"""Fuzz one decoder until libFuzzer's limits: ``python -m verification.atheris_fuzz.run dzb100 -runs=100000``.

This module imports nothing of drivebus itself, so that atheris instruments the decoders when they are first imported.
"""

from __future__ import annotations

import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any


def main(name: str) -> None:
    """Let atheris choose the inputs of one target; libFuzzer's options are those of the command line."""
    atheris: Any = import_module("atheris")
    with atheris.instrument_imports(include=["drivebus.protocols"], enable_loader_override=False):
        from verification.atheris_fuzz.targets import ATHERIS_TARGETS, MAX_INPUT_LENGTH
    target = ATHERIS_TARGETS[name]
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(target.seeds()):
            Path(folder, str(number)).write_bytes(seed)
        options = [sys.argv[0], f"-max_len={MAX_INPUT_LENGTH}", "-timeout=10", *sys.argv[2:], folder]
        atheris.Setup(options, target.run_input)
        atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1])
