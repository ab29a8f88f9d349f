"""Every ``drivebus`` command of the README, the tutorials and the how-to pages runs as it is printed, or is named here.

Commands for a drive get a simulated one behind a pty in the place of ``/dev/ttyUSB0``, and a profile that permits it
late replies: on a busy machine its process may have to wait. A scan takes no profile: its drive is in its own process.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drivebus import i18n
from fixtures.child_process import CHILD_TIMEOUT_S, COMMAND, ENVIRONMENT, lines_until
from fixtures.manual_answers import ANSWERS
from test_guides import NAMES, PAGES, README, blocks, command_lines

pytest.importorskip("pty")
pytestmark = pytest.mark.xdist_group("commands")

PORT = "/dev/ttyUSB0"
PAGES_IN_ENGLISH = [README, *(page for page, name in zip(PAGES, NAMES, strict=True) if ".zh" not in name)]
NOT_RUN = {
    "calibrate": "asks for what a person reads on the keypad: tests/cli/test_calibrate.py",
    "jog": "turns the motor while a key is held: tests/cli/test_remote_jog.py",
    "acceptance": "needs a real drive and a person beside it: tests/commissioning/test_acceptance.py",
    "monitor": "draws a screen: tests/cli/test_tui.py",
    "demo": "tests/system/test_demo_dashboard.py",
    "service": "changes the machine: tests/service/process/test_systemd_unit.py",
}
"""Commands of the pages that this test does not run, with the reason and the place where they are tested."""
PASSWORD = "seven quiet pumps hum"
WHOLE_SCAN = "a scan without --addresses takes up to 49 min"
OWN_SERVICE = "a command for the service of the reader's own plant: tests/cli/test_remote_commands.py"
STATED_STEP = ["--option", "setpoint_step=0.01"]
"""What the calibration before it has stored: without it a C320 is not started above 0.5 Hz."""


@dataclass
class Bench:
    """Folder of a reader, with a simulated drive behind a pty."""

    folder: Path
    model: str
    address: str
    skipped: list[str] = field(default_factory=list)

    @property
    def link(self) -> str:
        return str(self.folder / "ttyUSB0")

    @property
    def environment(self) -> dict[str, str]:
        return ENVIRONMENT | {"HOME": str(self.folder), "XDG_CONFIG_HOME": str(self.folder / "config")}

    @contextmanager
    def started(self, words: list[str]) -> Iterator[subprocess.Popen[str]]:
        with subprocess.Popen(
            [*COMMAND, *words],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process:
            try:
                yield process
            finally:
                process.kill()

    @contextmanager
    def drive(self) -> Iterator[None]:
        words = ["simulate", "--model", self.model, "--address", self.address, "--bind", "pty", "--link", self.link]
        with self.started(words) as process:
            lines_until(process, lambda line: "Ctrl-C" in line)
            yield

    def run(self, words: list[str], given: str = "") -> None:
        done = subprocess.run(
            [*COMMAND, *words],
            cwd=self.folder,
            env=self.environment,
            input=given,
            capture_output=True,
            text=True,
            timeout=CHILD_TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, (words, done.stdout + done.stderr)

    def run_until(self, words: list[str], wanted: Callable[[str], bool], ending: signal.Signals, code: int) -> None:
        """Run a command that goes on until it is ended; ``code`` is its exit code then."""
        with self.started(words) as process:
            lines_until(process, wanted)
            process.send_signal(ending)
            rest = process.communicate(timeout=CHILD_TIMEOUT_S)[0]
            assert process.returncode == code, (words, rest)

    def late_replies_profile(self, model: str) -> str:
        """Return a profile like that of ``model``, by name or path, which waits 0.3 s longer for a reply."""
        name = "./late-replies.toml"
        timing = '[timing]\nadapter_latency_s = 0.3\nevidence = "user"\n'
        text = f'format = 1\nextends = "{model}"\nmodel = "late_replies"\n{timing}'
        (self.folder / name).write_text(text, encoding="utf-8")
        return name

    def execute(self, line: list[str]) -> None:
        """Run a command of a page with the simulated drive; note it where it is not run."""
        port = f"sim://{self.model}@{self.address}" if line[1] == "scan" else self.link
        own = {"/tmp/": f"{self.folder}/", "/etc/drivebus/": f"{self.folder}/", PORT: port, "4711": "1"}
        words = line[1:]
        if PORT in words and "--model" in words:
            at = words.index("--model") + 1
            words = [*words[:at], self.late_replies_profile(words[at]), *words[at + 1 :]]
        for printed, here in own.items():  # 4711 is a page's example of a number in one's own log
            words = [word.replace(printed, here) for word in words]
        command = words[0]
        if command in NOT_RUN:
            self.skipped.append(command)
        elif "--service" in words:
            self.skipped.append(OWN_SERVICE)
        elif command == "scan" and "--addresses" not in words:
            self.skipped.append(WHOLE_SCAN)
        elif command == "init" and "sim://" not in words[1]:
            self.skipped.append(WHOLE_SCAN)
            self.run(["init", "sim://c320@3", *words[2:], "--models", "c320", "--addresses", "3"])
        elif command == "run" and "--dry-run" not in words and "--detach" not in words:
            started = [*words, *STATED_STEP]
            self.run_until(started, lambda text: "Confirmed" in text, signal.SIGINT, 130)
        elif command == "serve":
            self.run_until(words, lambda text: "http://" in text, signal.SIGTERM, 0)
        elif words[:2] == ["profile", "new"]:
            self.run(words, given="".join(f"{answer}\n" for answer in ANSWERS.values()))
        elif command == "simulate":
            self.run_until(words, lambda text: "Ctrl-C" in text, signal.SIGINT, 0)
        else:
            self.run(words, given=f"{PASSWORD}\n")


def model_of(lines: list[list[str]]) -> tuple[str, str]:
    """Return model and address of the drive that a page's commands talk to."""
    for words in lines:
        if PORT in words and "--model" in words and "--address" in words:
            model = words[words.index("--model") + 1]
            return "c320" if model.startswith("./") else model, words[words.index("--address") + 1]
    return "c320", "3"


WITH_COMMANDS = [page for page in PAGES_IN_ENGLISH if command_lines(page, "")]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=[page.name for page in WITH_COMMANDS])
def test_the_commands_of_a_page_run_as_printed(page: Path, tmp_path: Path) -> None:
    lines = command_lines(page, "")
    bench = Bench(tmp_path, *model_of(lines))
    (tmp_path / "state").mkdir(mode=0o700)
    if not any(words[1] == "init" and "plant.toml" in words for words in lines):
        (tmp_path / "plant.toml").write_text('format = 1\n[plant]\nid = "p"\ndirectory = "state"\n', encoding="utf-8")
    if any(words[1] == "audit" for words in lines):
        bench.run(["user", "add", "plant.toml", "first", "--role", "viewer"], given=f"{PASSWORD}\n")
    for language, text in blocks(page):
        if language == "toml" and "extends" in text:
            (tmp_path / "my-c320.toml").write_text(text, encoding="utf-8")
            break
    with bench.drive():
        for words in lines:
            bench.execute(words)
    assert set(bench.skipped) <= {*NOT_RUN, WHOLE_SCAN, OWN_SERVICE}


def test_the_readme_leads_from_make_demo_to_the_command_in_a_fresh_shell(tmp_path: Path) -> None:
    (line,) = [line for _, text in blocks(README) for line in text.splitlines() if "activate" in line]
    other = [line for _, text in blocks(README.with_name("README.zh.md")) for line in text.splitlines()]
    assert line.partition("#")[0].strip() in [each.partition("#")[0].strip() for each in other]
    (tmp_path / ".venv").symlink_to(sys.prefix)  # where `make demo` puts it
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path / "home"), "LANG": "C.UTF-8"}
    script = f"{line}\ncommand -v drivebus\ndrivebus --version"
    done = subprocess.run(
        ["sh", "-e", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    where, version = done.stdout.splitlines()[-2:]
    assert (Path(sys.prefix) / "bin").samefile(Path(where).parent) and version.startswith("drivebus")


@pytest.mark.parametrize(
    ("language", "name", "quoted"),
    [("en", "first-dashboard.md", r"(?<!\*)\*([^*]+)\*(?!\*)"), ("zh", "first-dashboard.zh.md", "“([^”]+)”")],
)
def test_the_tutorial_names_buttons_as_the_page_does(language: str, name: str, quoted: str) -> None:
    text = (README.parent / "docs" / "tutorials" / name).read_text(encoding="utf-8")
    demo = text[text.index("## 1.") : text.index("## 2.")]
    catalogue = Path(i18n.__file__).parent / f"page.{language}.json"
    names = set(json.loads(catalogue.read_text(encoding="utf-8")).values())
    buttons = [found.replace("\n  ", " ") for found in re.findall(quoted, demo)]
    assert len(buttons) >= 6 and [button for button in buttons if button not in names] == []
