"""Environment of the service process: log, watchdog, child processes, lock."""

from __future__ import annotations

import asyncio
import errno
import io
import itertools
import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus.cli.commands import serve
from drivebus.cli.errors import ExitCode
from drivebus.errors import ConfigurationError
from drivebus.service.process import gateways, logging_setup
from drivebus.service.process.gateways import ChildProcess
from drivebus.service.process.lock import single_instance
from drivebus.service.process.systemd import MAX_BUS_LATENESS_S, SystemdNotifier, is_bus_alive
from drivebus.testing.virtual_time import run
from fixtures.service import plant_config, running_service


def record_of(text: str, drive: str | None = None) -> logging.LogRecord:
    record = logging.LogRecord("drivebus.service", logging.WARNING, "", 0, text, (), None)
    record.event = {"kind": "presence", "drive": drive, "actor": None, "outcome": None}
    return record


def test_no_text_forges_a_line_of_the_log_or_sends_escape_sequences() -> None:
    evil = "gone\n2026-01-01T00:00:00+00:00 INFO pump-1: all is well\x1b[2J\r"
    plain = logging_setup.PlainFormatter().format(record_of(evil, "fan-1"))
    assert "\n" not in plain and "\r" not in plain and "\x1b" not in plain and "fan-1: gone" in plain
    found = json.loads(logging_setup.JsonFormatter().format(record_of(evil, "fan-1")))
    assert found["text"] == evil and found["drive"] == "fan-1" and found["level"] == "warning"
    assert "\n" not in logging_setup.JsonFormatter().format(record_of(evil))


def test_a_sentence_that_begins_with_its_drive_has_no_second_name_and_another_drive_does_not_count() -> None:
    for text, shown in (
        ("p1 was already running", "WARNING p1 was already running"),
        ("p1：没有新的数值", "WARNING p1：没有新的数值"),
        ("p10 was stopped", "WARNING p1: p10 was stopped"),
        ("stop confirmed", "WARNING p1: stop confirmed"),
    ):
        assert logging_setup.PlainFormatter().format(record_of(text, "p1")).endswith(shown)


def test_a_drive_without_confirmed_stop_at_the_end_is_logged(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ended(
        setting: Any, *, without: Any, address_output: str, log_format: str, on_ready: Any
    ) -> dict[str, Any]:
        kept = {"fan-2": {"status": "confirmed"}, "fan-3": {"status": "acknowledged"}}
        return {"fan-1": None, **kept, "fan-4": {"kind": "StopUnconfirmed"}}

    lines: list[str] = []
    monkeypatch.setattr("drivebus.service.process.main.run_service", ended)

    def record(text: str, extra: dict[str, Any]) -> None:
        line = logging_setup.PlainFormatter().format(record_of(text, extra["event"]["drive"]))
        lines.append(line.partition(" WARNING ")[2])

    monkeypatch.setattr(logging_setup.LOG, "error", record)
    assert asyncio.run(serve._run(plant_config(), (), "text")) is ExitCode.UNKNOWN
    end = "stop not confirmed. Check the drive locally; use the hard-wired stop."
    assert lines == [f"{drive}: {end}" for drive in ("fan-1", "fan-4")], "each drive is named once"


def test_a_log_without_a_reader_blocks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    ending: list[Any] = []
    monkeypatch.setattr(logging_setup.atexit, "register", lambda *what: ending.append(partial(*what)))
    monkeypatch.setattr(logging_setup, "FLUSH_TIMEOUT_S", 0.05)
    monkeypatch.setattr(logging_setup, "MAX_QUEUED_RECORDS", 3)
    root = logging.getLogger("drivebus")
    loggers = (root, logging.getLogger())
    before = [(logger.handlers, logger.level, logger.propagate) for logger in loggers]
    reader, writer = socket.socketpair()
    event = {"kind": "stop", "drive": None, "text": {"en": "stop", "zh": "停"}, "actor": "x", "outcome": None}

    class Hanging(io.StringIO):
        def write(self, text: str) -> int:
            reader.recv(1)  # until the test lets it go
            return len(text)

    try:
        logging_setup.configure_logging("text", Hanging())
        for _ in range(50):
            logging_setup.log_event(event)
        assert root.handlers[0].queue.qsize() <= 3  # type: ignore[attr-defined]
        ending[0]()
    finally:
        writer.close()
        ending[0]()
        reader.close()
        for logger, (handlers, level, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate
            logger.setLevel(level)


def test_a_process_without_a_free_file_descriptor_logs_sentences_and_not_their_keys() -> None:
    """The texts were read at the first line of the log, which a flood of connections made impossible."""
    script = """if True:
        import resource
        from drivebus import i18n
        from drivebus.service.process.logging_setup import configure_logging
        configure_logging("json")
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))
        print([i18n.text("log.connections_closed", language, count=7) for language in i18n.LANGUAGES])
    """
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert "connections closed at once: 7" in printed and "log.connections_closed" not in printed


def test_messages_of_a_library_that_are_alike_do_not_fill_the_log() -> None:
    now = [0.0]
    repetition = logging_setup.RepetitionFilter(lambda: now[0])

    def shown(name: str, text: str) -> str | None:
        record = logging.LogRecord(name, logging.ERROR, "", 0, text, None, None)
        return record.getMessage() if repetition.filter(record) else None

    assert shown("uvicorn.error", "Invalid HTTP request received.") == "Invalid HTTP request received."
    assert [shown("uvicorn.error", "Invalid HTTP request received.") for _ in range(2500)] == [None] * 2500
    assert shown("asyncio", "socket.accept() out of system resource\nsocket: 7") is not None
    assert shown("asyncio", "socket.accept() out of system resource\nsocket: 8") is None
    assert [shown("drivebus.service", "fan-1 no longer replies") for _ in range(3)].count(None) == 0
    now[0] = logging_setup.REPETITION_INTERVAL_S
    assert shown("uvicorn.error", "Invalid HTTP request received.") == "Invalid HTTP request received. (and 2500 more)"
    for number in range(3 * logging_setup.MAX_MESSAGE_KINDS):
        assert shown("library", f"{number} is new") is not None
    assert len(repetition._passed) <= logging_setup.MAX_MESSAGE_KINDS


def test_the_watchdog_is_fed_only_while_every_bus_does_its_due_work(tmp_path: Path) -> None:
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.setblocking(False)
    notify = SystemdNotifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000"})

    def bus(overdue_s: float, is_open: bool = True) -> Any:
        return SimpleNamespace(bus=SimpleNamespace(overdue_s=overdue_s, is_open=is_open, is_closed=False))

    notify.feed_watchdog([bus(0.0), bus(0.1)], 10.0)
    assert manager.recv(100) == b"WATCHDOG=1"
    for buses, now in (([bus(0.0)], 10.5), ([bus(0.0), bus(MAX_BUS_LATENESS_S)], 12.0)):
        notify.feed_watchdog(buses, now)
        with pytest.raises(BlockingIOError):
            manager.recv(100)
    notify.feed_watchdog([bus(0.0), bus(99.0, is_open=False)], 12.5)  # its loss is known, and it is opened again
    assert manager.recv(100) == b"WATCHDOG=1"
    manager.close()
    notify.send("READY=1")  # the manager is gone: no error
    SystemdNotifier({}).send("READY=1")


def test_a_bus_that_is_late_with_its_due_work_is_not_alive() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            runtime = kit.service.plant.buses["a"]
            assert is_bus_alive(runtime)
            runtime.bus._timer.set(None)  # type: ignore[union-attr]
            runtime.bus._arm_timer = lambda: None  # type: ignore[method-assign]
            await asyncio.sleep(10)
            assert not is_bus_alive(runtime)

    run(scenario())


def test_a_gateway_that_ends_is_started_again_with_growing_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        begun: list[float] = []
        exits: list[tuple[int, bool]] = []
        stdin = SimpleNamespace(write=lambda line: None)
        runs_s = iter([0.0, 0.0, 0.0, gateways.STEADY_RUN_S, 0.0, 1000.0])

        class Child:
            returncode: int | None = 3
            pid = 1

            def __init__(self) -> None:
                self.stdin = stdin

            async def wait(self) -> int:
                await asyncio.sleep(next(runs_s))
                return 3

        async def started(*command: str, **how: Any) -> Child:
            begun.append(loop.time())
            return Child()

        monkeypatch.setattr(asyncio, "create_subprocess_exec", started)
        child = ChildProcess(["web"], b"", loop.time, on_exit=lambda *exit: exits.append(exit))
        child.start()
        await asyncio.sleep(100)
        pauses = [round(later - earlier, 3) for earlier, later in itertools.pairwise(begun)]
        assert pauses == [0.5, 1.0, 2.0, gateways.STEADY_RUN_S + 0.5, 1.0]
        assert exits == [(3, False), (3, True), (3, True), (3, False), (3, True)]
        await child.close()

    run(scenario())


def ignores(pid: int, number: signal.Signals) -> bool:
    """Return whether a process ignores a signal; see ``proc_pid_status(5)``."""
    found = re.search(r"SigIgn:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
    return found is not None and bool(int(found[1], 16) >> number - 1 & 1)


def test_a_gateway_that_ignores_sigterm_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gateways, "TERMINATE_TIMEOUT_S", 0.1)
    stubborn = "import signal,time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(60)"

    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        child = ChildProcess([sys.executable, "-c", stubborn], b"", loop.time)
        child.start()
        while child.process is None:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        while not ignores(child.process.pid, signal.SIGTERM):  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        assert os.getpgid(child.process.pid) == child.process.pid, "no Ctrl-C of the service's terminal reaches it"
        assert os.getsid(child.process.pid) == os.getsid(0), "one session, whose processor its niceness shares"
        await child.close()
        assert child.process.returncode == -signal.SIGKILL

    asyncio.run(scenario())


def test_a_state_directory_serves_one_service_and_is_private_to_its_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = tmp_path / "a" / "state"
    with single_instance(folder):
        assert folder.stat().st_mode & 0o777 == 0o700
        with pytest.raises(ConfigurationError, match="already uses"), single_instance(folder):
            raise AssertionError
    with monkeypatch.context() as context:
        context.setattr(os, "write", full)
        with single_instance(folder):  # a service that crashed on a full disk starts again
            pass
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="can't be used"), single_instance(tmp_path / "file"):
        raise AssertionError


def test_the_service_imports_of_a_gateway_only_its_declaration() -> None:
    """A small process without HTTP, also after it has read a plant file."""
    code = (
        "import sys, drivebus.service.process.main; from drivebus.service import config;"
        "config.loads('format = 1\\n[plant]\\nid = \"p\"'); print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()} | {*done.stdout.split()}
    assert not loaded & {"fastapi", "uvicorn", "starlette", "drivebus.gateways"}
    assert {name for name in loaded if name.startswith("drivebus.web")} == {"drivebus.web", "drivebus.web.gateway"}
