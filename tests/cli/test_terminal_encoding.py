"""Output on a terminal whose encoding lacks characters of the texts."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("encoding", ["latin-1", "cp866"])
def test_a_terminal_without_utf_8_shows_plain_characters_and_json_their_escapes(encoding: str) -> None:
    r"""A missing value was ``\u2013`` there, and each ``…`` of a message ``\u2026``."""
    words = [sys.executable, "-m", "drivebus", "status", "sim://c320@1", "--model", "c320", "--address", "1"]
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    for lang, absent in (("en", " - "), ("zh", " - ")):
        shown = subprocess.run([*words, "--lang", lang], capture_output=True, env=environment, check=True).stdout
        text = shown.decode(encoding)
        [line] = [line for line in text.splitlines() if line.startswith("set_frequency")]
        assert absent in line and "\\u2013" not in text
        assert ("\\u8bbe" in line) is (lang == "zh"), "nothing stands for a Chinese character but its escape"
    document = subprocess.run([*words, "--lang", "zh", "--json"], capture_output=True, env=environment, check=True)
    reading = json.loads(document.stdout.decode(encoding))["readings"]["set_frequency"]
    assert reading["value"] is None and any("该型号" in str(value) for value in reading.values())
