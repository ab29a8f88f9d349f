"""The page on using the API: its blocks run in their order against a service, and print what the page shows."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

import pytest

import peers
from drivebus import i18n
from drivebus.cli.demo.host import free_port
from fixtures.child_process import COMMAND, ENVIRONMENT, lines_until
from test_guides import blocks

PAGE = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "use-the-api.md"
pytestmark = pytest.mark.xdist_group("commands")
PASSWORD = "seven quiet pumps hum"
BLOCK_TIMEOUT_S = 60.0


def test_both_languages_have_the_same_blocks() -> None:
    assert blocks(PAGE) == blocks(PAGE.with_name("use-the-api.zh.md"))


class Reader:
    """A reader of the page who follows it in an empty folder, on a port that is free."""

    def __init__(self, folder: Path) -> None:
        self.folder, port = folder, str(free_port(0))
        self.blocks = [(kind, text.replace("8080", port)) for kind, text in blocks(PAGE)]
        self.environment = ENVIRONMENT | {"HOME": str(folder)}
        text = self.texts("toml")[0]
        (folder / "plant.toml").write_text(text, encoding="utf-8")

    def texts(self, kind: str) -> list[str]:
        return [text for found, text in self.blocks if found == kind]

    def program(self, block: int) -> tuple[list[str], list[str]]:
        """Return the command that runs a block, and the lines that the page shows below it."""
        kind, text = self.blocks[block]
        (below, printed) = self.blocks[block + 1]
        assert below == "text"
        return (["sh", "-e", "-c", text] if kind == "sh" else [sys.executable, "-c", text]), printed.splitlines()

    def finished(self, command: list[str], given: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment,
            input=given,
            capture_output=True,
            text=True,
            timeout=BLOCK_TIMEOUT_S,
            check=False,
        )

    def run(self, command: list[str], given: str = "") -> list[str]:
        done = self.finished(command, given)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.splitlines()

    @contextmanager
    def started(self, command: list[str]) -> Iterator[subprocess.Popen[str]]:
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process:
            try:
                yield process
            finally:
                process.terminate()

    @contextmanager
    def service(self) -> Iterator[None]:
        """Run the page's commands up to its service, and give the token to what follows."""
        add, token, serve = (shlex.split(line)[1:] for line in self.texts("")[0].splitlines())
        self.run([*COMMAND, *add], given=f"{PASSWORD}\n")
        self.environment |= {"DRIVEBUS_TOKEN": self.run([*COMMAND, *token])[0]}
        with self.started([*COMMAND, *serve]) as service:
            lines_until(service, lambda line: line.startswith("http://"))
            yield


def test_every_block_of_the_page_prints_what_the_page_shows(tmp_path: Path) -> None:
    peers.need_program("curl", "curl")
    reader = Reader(tmp_path)
    numbered = [(number, kind) for number, (kind, _) in enumerate(reader.blocks)]
    (curl,) = [number for number, kind in numbered if kind == "sh"]
    python, live = [number for number, kind in numbered if kind == "python"]
    with reader.service():
        watcher, states = reader.program(live)
        with reader.started(watcher) as watching:
            assert watching.stdout is not None
            printed = [lines_until(watching, lambda line: line == "stopped\n")[-1].strip()]  # the first poll is over
            command, expected = reader.program(curl)
            assert reader.run(command) == expected
            printed += [line.strip() for line in watching.stdout]
        assert watching.returncode == 0
        long_states = {"stopped", "running"}  # the others can fall between two polls
        seen = [state for state, _ in groupby(state for state in printed if state in long_states)]
        assert seen == ["stopped", "running", "stopped"], printed
        assert set(printed) <= {*states, "unknown"}, "unknown: a loaded machine read the drive late"
        command, expected = reader.program(python)
        assert reader.run(command) == expected


def test_the_start_with_curl_ends_with_the_sentence_of_its_error(tmp_path: Path) -> None:
    """With a wrong token it waited for ever for a motor that was never started, without a word."""
    peers.need_program("curl", "curl")
    reader = Reader(tmp_path)
    (curl,) = [number for number, (kind, _) in enumerate(reader.blocks) if kind == "sh"]
    command, _ = reader.program(curl)
    with reader.service():
        reader.environment["DRIVEBUS_TOKEN"] = "dbt_wrong"
        done = reader.finished([word for word in command if word != "-e"])  # as in a terminal
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == i18n.text("auth.not_logged_in", "en") + "\n"


def test_the_start_with_curl_ends_with_a_stop_when_control_is_lost(tmp_path: Path) -> None:
    """Regression: it ended with the error of the renewal, and the motor went on."""
    peers.need_program("curl", "curl")
    reader = Reader(tmp_path)
    plant = tmp_path / "plant.toml"
    plant.write_text(plant.read_text(encoding="utf-8").replace("ramp=2", "ramp=60"), encoding="utf-8")
    (start,) = reader.texts("sh")
    functions = start.partition("\n(")[0] + "\n"
    release = f'mkdir other; cd other; {functions}api -X DELETE "$DRIVE/lease"'  # with an answer.json of its own
    wait = f'{functions}until api "$DRIVE"; [ "$(field state)" = stopped ]; do sleep 0.2; done'
    with reader.service(), reader.started(["sh", "-c", start]) as starting:
        lines_until(starting, lambda line: line == "confirmed\n")
        reader.run(["sh", "-c", release])
        assert starting.stdout is not None
        assert starting.stdout.read() == "confirmed\n", "the outcome of the stop"
        assert starting.wait(BLOCK_TIMEOUT_S) == 1
        reader.run(["sh", "-c", wait])
