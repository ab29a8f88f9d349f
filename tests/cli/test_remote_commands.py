"""``--service``: the verbs against a running plant, over HTTP and over its socket; the same words and exit codes."""

from __future__ import annotations

import asyncio
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.cli.tui.service_source import ServiceRowSource
from drivebus.drives.state import DriveState
from drivebus.errors import ConfigurationError, OutcomeUnknown
from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.rights import Role
from fixtures.child_process import ENVIRONMENT, lines_until, running_command
from fixtures.running_service import RunningService, http_service, token

FAN = ("--drive", "fan-1")


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with http_service(Path(tmp_path_factory.mktemp("plant"))) as found:
        found.run_in_loop(lambda: found.kit.grant_waivers())
        found.run_in_loop(lambda: all_seen(found))
        yield found


async def all_seen(plant: RunningService) -> None:
    """Every drive has told its state."""
    while any(one["state"] == "unknown" for one in (await plant.kit.call("drives.list"))["drives"]):  # noqa: ASYNC110
        await asyncio.sleep(0.05)


@pytest.fixture(params=["http", "socket"])
def service(request: pytest.FixtureRequest, plant: RunningService, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Where the plant is; afterwards everything stands and nobody owns anything."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    yield plant.url if request.param == "http" else str(plant.socket)
    for drive in plant.kit.service.plant.drives:
        plant.run_in_loop(lambda drive=drive: plant.kit.call("drive.stop", drive=drive))  # type: ignore[misc]
        plant.kit.service.plant.leases.remove_drive(drive)


def verb(service: str, name: str, *words: str, code: int = 0) -> dict[str, Any]:
    """The document of a verb that must end with ``code``."""
    result = CliRunner().invoke(cli, [name, "--service", service, *words, "--json"])
    assert result.exit_code == code, result.output
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def rest(plant: RunningService, path: str, role: Role = Role.ENGINEER) -> Any:
    headers = {"Authorization": f"Bearer {token(role)}"}
    return httpx.get(f"{plant.url}{API_PREFIX}{path}", headers=headers).raise_for_status().json()


def state(plant: RunningService) -> DriveState:
    """Newer than this question."""
    asked_at = time.monotonic()
    while True:
        view = rest(plant, "/drives/fan-1")
        if view["time_ms"] - view["state_time_ms"] < 1000 * (time.monotonic() - asked_at):
            return DriveState(view["state"])
        time.sleep(0.05)


def test_status_tells_what_the_service_knows(service: str) -> None:
    found = verb(service, "status", *FAN)
    assert (found["port"], found["model"], found["address"], found["state"]) == (service, "c320", 1, "stopped")
    reading = found["readings"]["output_frequency"]
    assert (reading["value"], reading["quality"]) == (0.0, "good") and reading["age_s"] < 30.0


@pytest.mark.parametrize("language", ["en", "zh"])
def test_status_is_told_to_people_in_their_language(service: str, language: str) -> None:
    words = ["status", "--service", service, *FAN, "--lang", language]
    text = CliRunner().invoke(cli, words, env={"COLUMNS": "200"}).output
    assert ("停止" if language == "zh" else "stopped") in text and "service." not in text


def test_parameters_are_read_and_written_and_read_back(service: str) -> None:
    outcome = verb(service, "write", *FAN, "F1.7=12.5", code=ExitCode.FAILED)
    assert outcome["error"]["key"] == "drives.not_writable"
    outcome = verb(service, "write", *FAN, "F1.10=1")
    assert outcome["outcome"] == "confirmed" and outcome["evidence"]
    rows = verb(service, "read", *FAN, "F1.10", "output_frequency")["values"]
    assert (rows[0]["notation"], rows[0]["value"]) == ("F1.10", 1.0)


def test_a_detached_run_a_new_setpoint_and_a_stop(plant: RunningService, service: str) -> None:
    words = ["run", "--service", service, *FAN, "--frequency", "20", "--detach", "--json"]
    done = CliRunner().invoke(cli, words)
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.exit_code == 0, done.output
    assert [one["event"] for one in events] == ["comm_loss", "started"]
    assert state(plant).driven
    assert verb(service, "set-frequency", *FAN, "15")["outcome"] == "acknowledged"
    assert rest(plant, "/drives/fan-1")["lease"] is None
    stopped = verb(service, "stop", *FAN)
    assert (stopped["outcome"], state(plant)) == ("confirmed", DriveState.STOPPED)


def test_ctrl_c_stops_the_drive_of_an_attached_run_and_gives_it_back(plant: RunningService, service: str) -> None:
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.ENGINEER)
    with running_command("run", "--service", service, *FAN, "--frequency", "20", "--json") as process:
        seen = lines_until(process, lambda line: '"event": "status"' in line)
        assert json.loads(seen[0])["event"] == "started" and state(plant).turning
        assert rest(plant, "/drives/fan-1")["lease"] is not None
        process.send_signal(signal.SIGINT)
        last = lines_until(process, lambda line: '"stopped"' in line)[-1]
        assert process.wait(20) == ExitCode.INTERRUPTED
    assert json.loads(last)["outcome"] == "confirmed"
    assert (state(plant), rest(plant, "/drives/fan-1")["lease"]) == (DriveState.STOPPED, None)


def test_bus_stop_stops_the_whole_plant(plant: RunningService, service: str) -> None:
    found = verb(service, "stop", "--all")
    everybody = sorted(plant.kit.service.plant.drives)
    assert (sorted(found["confirmed"]), found["unconfirmed"]) == (everybody, [])
    for drive in everybody:
        plant.run_in_loop(lambda drive=drive: plant.kit.call("start_inhibit.release", drive=drive))  # type: ignore[misc]


def test_a_limit_refuses_through_the_service_as_it_does_on_a_line(service: str) -> None:
    """The same error, the same exit code."""
    own = CliRunner().invoke(
        cli, ["set-frequency", "sim://c320@1", "60", "--model", "c320", "--address", "1", "--json"]
    )
    served = verb(service, "set-frequency", *FAN, "60", code=own.exit_code)
    message = json.loads(own.stdout)["error"]
    assert [served["error"][name] for name in ("type", "key", "text")] == [
        message[name] for name in ("type", "key", "text")
    ]


def test_who_owns_the_drive_is_not_disturbed(
    plant: RunningService, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lease that another program of ours holds stays; one of somebody else is refused."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.OPERATOR))
    headers = {"Authorization": f"Bearer {token(Role.OPERATOR)}"}
    httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=headers).raise_for_status()
    if service == plant.url:
        verb(service, "set-frequency", *FAN, "10")
        assert rest(plant, "/drives/fan-1")["lease"]["owner"] == "operator/test"
        engineer = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
        httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=engineer).raise_for_status()
        refused = verb(service, "set-frequency", *FAN, "10", code=ExitCode.FAILED)
        assert refused["error"]["key"] == "plant.not_owner"
        assert rest(plant, "/drives/fan-1")["lease"]["owner"] == "engineer/test"
    else:
        monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    stopped = verb(service, "stop", *FAN)
    assert stopped["outcome"] == "confirmed"


def test_a_viewer_may_look_and_nothing_else(plant: RunningService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.VIEWER))
    verb(plant.url, "status", *FAN)
    for words in (["stop", *FAN], ["set-frequency", *FAN, "10"], ["write", *FAN, "F1.10=1"], ["stop", "--all"]):
        found = verb(plant.url, words[0], *words[1:], code=ExitCode.FAILED)
        assert found["error"]["key"] == "auth.forbidden"


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (["status", "--service", "http://127.0.0.1:1"], "service.no_drive"),
        (["status", "sim://c320@1", "--model", "c320", "--address", "1", "--drive", "x"], "service.drive_alone"),
        (["stop", "--service", "x", *FAN, "--dry-run"], "service.not_with"),
        (["stop", "--service", "x", *FAN, "--model", "c320"], "service.not_with"),
        (["run", "--service", "x", *FAN, "--frequency", "1", "--wait"], "service.not_with"),
        (["stop", "--all", "--service", "x", "--address", "1"], "service.not_with"),
        (["monitor", "--service", "x", "--record", "a.dbcap"], "service.not_with"),
        (["status", "--service", "ftp://127.0.0.1", *FAN], "service.address"),
        (["status", "--service", "http://a:b@127.0.0.1", *FAN], "service.address"),
        (["status", "--service", "http://127.0.0.1:99999", *FAN], "service.address"),
        (["status", "--service", "http://10.0.0.7", *FAN], "service.not_secret"),
    ],
)
def test_what_can_not_be_meant_is_a_wrong_command_line(
    words: list[str], key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    result = CliRunner().invoke(cli, [*words, "--json"])
    assert (result.exit_code, json.loads(result.stdout)["error"]["key"]) == (ExitCode.USAGE, key)


@pytest.mark.parametrize(("value", "key"), [(None, "service.no_token"), ("a\nb", "service.token")])
def test_without_a_token_nothing_is_asked(monkeypatch: pytest.MonkeyPatch, value: str | None, key: str) -> None:
    monkeypatch.delenv("DRIVEBUS_TOKEN", raising=False)
    if value is not None:
        monkeypatch.setenv("DRIVEBUS_TOKEN", value)
    assert verb("http://127.0.0.1:1", "status", *FAN, code=ExitCode.USAGE)["error"]["key"] == key


def test_nobody_there_says_that_nothing_was_sent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    assert verb("http://127.0.0.1:1", "status", *FAN, code=ExitCode.FAILED)["error"]["key"] == "service.not_there"
    assert verb(str(tmp_path / "plant.sock"), "status", *FAN, code=ExitCode.FAILED)["error"]["key"] == "plant.not_there"


class Strange(BaseHTTPRequestHandler):
    """Answers like a service until it is asked to act; then as ``reply`` says."""

    reply: Callable[[Strange], None]

    def do_GET(self) -> None:
        self._say(200, {"model": "c320", "address": 1, "lease": None})

    def do_POST(self) -> None:
        type(self).reply(self)

    def _say(self, status: int, found: Any, **headers: str) -> None:
        body = json.dumps(found).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        return


@pytest.fixture
def strange(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    server = HTTPServer(("127.0.0.1", 0), Strange)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_an_answer_that_does_not_come_leaves_it_unknown(strange: str) -> None:
    """Exit 4, not 1: the stop may have been done, or not."""
    Strange.reply = lambda self: self.connection.close()  # type: ignore[method-assign]
    assert verb(strange, "stop", *FAN, code=ExitCode.UNKNOWN)["error"]["type"] == OutcomeUnknown.__name__


def test_a_redirect_is_not_followed_with_the_token(strange: str) -> None:
    Strange.reply = lambda self: self._say(307, {}, Location="http://127.0.0.1:1/")  # type: ignore[method-assign]
    assert verb(strange, "stop", "--all", code=ExitCode.UNKNOWN)["error"]["key"] == "service.not_stopped"


def test_the_live_view_shows_the_plant_and_then_that_it_is_gone(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.VIEWER))
    shown = CliRunner().invoke(cli, ["monitor", "--service", plant.url, "--json", "--duration", "0.2"])
    first = next(one for one in map(json.loads, shown.stdout.splitlines()) if "drives" in one)
    assert [one["drive"] for one in first["drives"]] == ["fan-1", "fan-2", "pump-1", "pump-2"], shown.output
    feed = ServiceRowSource(plant.url)
    feed._drives = [_row(plant)]
    feed._mark_unreachable(ConfigurationError("service.token"))
    assert (feed.drives()[0].presence, feed.drives()[0].readings, len(feed.news())) == ("offline", {}, 2)


def _row(plant: RunningService) -> Any:
    from drivebus.cli.tui.service_source import remote_drive_row

    return remote_drive_row(rest(plant, "/drives/fan-1"), 0.0)


def test_a_cursor_that_nobody_handed_out_is_named_in_the_sentence(plant: RunningService) -> None:
    """Found by schemathesis: rooms beside the desk left the places of the sentence empty."""
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    answer = httpx.get(f"{plant.url}{API_PREFIX}/audit", params={"cursor": "x"}, headers=headers)
    error = answer.json()["error"]
    assert (answer.status_code, error["params"]["operation"]) == (422, "audit.list")
    assert "{" not in error["text"]["en"] and "cursor" in error["text"]["zh"]
