"""``simulate`` on real ptys and sockets: its first line has the port URL, and a signal ends it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from fixtures.child_process import CHILD_TIMEOUT_S, COMMAND


@contextmanager
def simulated(*words: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Provide a running ``simulate`` and its first JSON document."""
    child = subprocess.Popen([*COMMAND, "simulate", "--json", *words], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        yield child, json.loads(child.stdout.readline())
    finally:
        child.kill()
        child.wait()


def test_the_first_document_has_the_url_of_an_existing_pty(tmp_path: Path) -> None:
    link = tmp_path / "drives"
    with simulated("--model", "c320", "--address", "0-3,7", "--link", str(link)) as (child, first):
        assert first["url"] == f"serial://{link}?baud=9600&format=8E1"
        assert first["stations"] == 5
        assert link.resolve().is_char_device()
        child.send_signal(signal.SIGTERM)
        assert child.wait(CHILD_TIMEOUT_S) == 0
    assert not link.exists()


def test_a_tcp_port_answers_a_real_frame() -> None:
    with simulated("--model", "vc660", "--address", "1", "--bind", "tcp://127.0.0.1:0") as (_, first):
        port = int(first["url"].split(":")[2].partition("?")[0])
        with socket.create_connection(("127.0.0.1", port), CHILD_TIMEOUT_S) as connection:
            connection.settimeout(CHILD_TIMEOUT_S)
            connection.sendall(bytes.fromhex("010330020001") + bytes.fromhex("2ACA"))
            received = b""
            while len(received) < 7:
                received += connection.recv(16)
    assert received[:3] == bytes.fromhex("010302")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_simulate_with_exit_code_0(number: signal.Signals) -> None:
    with simulated("--model", "df800", "--address", "1") as (child, _):
        child.send_signal(number)
        assert child.wait(CHILD_TIMEOUT_S) == 0


def test_an_existing_file_is_not_replaced_by_the_link(tmp_path: Path) -> None:
    existing = tmp_path / "mine"
    existing.write_text("precious")
    done = subprocess.run(
        [*COMMAND, "simulate", "--model", "c320", "--address", "1", "--link", str(existing)],
        capture_output=True,
        text=True,
        timeout=CHILD_TIMEOUT_S,
        env=os.environ | {"DRIVEBUS_LANG": "en"},
    )
    assert done.returncode == 1
    assert f"{existing} can't be opened for listening: File exists" in " ".join(done.stderr.split())
    assert existing.read_text() == "precious"
