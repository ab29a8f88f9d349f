"""Commands with ``--service`` on a running service, over HTTP and over its socket."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.commands import comm_loss_test as comm_loss_test_command
from drivebus.cli.drive_command import must_stop_after
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.cli.remote import http_client
from drivebus.cli.remote.convert import parse_error_outcome
from drivebus.cli.remote.drive import RemoteDrive
from drivebus.cli.signals import ShutdownSignal
from drivebus.cli.tui.service_source import ServiceRowSource
from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import DriveState
from drivebus.errors import ConfigurationError, NoReply, OutcomeUnknown, ProfileError, Superseded
from drivebus.service.api.errors import build_error_json, error_to_json
from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.actor import SERVICE_NAME
from drivebus.service.auth.rights import Role
from drivebus.service.control import comm_loss_test
from fixtures.child_process import CHILD_TIMEOUT_S, ENVIRONMENT, lines_until, running_command
from fixtures.running_service import RunningService, all_states_known, http_service, token
from fixtures.service import remote_actor

FAN = ("--drive", "fan-1")


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with http_service(Path(tmp_path_factory.mktemp("plant"))) as found:
        found.run_in_loop(lambda: found.kit.grant_waivers())
        found.run_in_loop(lambda: all_states_known(found))
        yield found


@pytest.fixture(params=["http", "socket"])
def service(request: pytest.FixtureRequest, plant: RunningService, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Provide the address or socket of the service; stop all drives and remove all leases afterwards."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    yield plant.url if request.param == "http" else str(plant.socket)
    for drive in plant.kit.service.plant.drives:
        plant.run_in_loop(lambda drive=drive: plant.kit.call("drive.stop", drive=drive))  # type: ignore[misc]
        plant.kit.service.plant.leases.remove_drive(drive)


def run_command(service: str, name: str, *words: str, code: int = 0) -> dict[str, Any]:
    """Run a command that must exit with ``code``; return its JSON document."""
    result = CliRunner().invoke(cli, [name, "--service", service, *words, "--json"])
    assert result.exit_code == code, result.output
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def rest(plant: RunningService, path: str, role: Role = Role.ENGINEER) -> Any:
    headers = {"Authorization": f"Bearer {token(role)}"}
    return httpx.get(f"{plant.url}{API_PREFIX}{path}", headers=headers).raise_for_status().json()


def state(plant: RunningService) -> DriveState:
    """Return a state that was read after this call."""
    called_at = time.monotonic()
    while True:
        view = rest(plant, "/drives/fan-1")
        if view["time_ms"] - view["state_time_ms"] < 1000 * (time.monotonic() - called_at):
            return DriveState(view["state"])
        time.sleep(0.05)


def test_status_shows_the_values_of_the_service(service: str) -> None:
    found = run_command(service, "status", *FAN)
    assert (found["port"], found["model"], found["address"], found["state"]) == (service, "c320", 1, "stopped")
    reading = found["readings"]["output_frequency"]
    assert (reading["value"], reading["quality"]) == (0.0, "good") and reading["age_s"] < 30.0


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_text_of_status_is_in_the_users_language(service: str, language: str) -> None:
    words = ["status", "--service", service, *FAN, "--lang", language]
    text = CliRunner().invoke(cli, words, env={"COLUMNS": "200"}).output
    assert ("停止" if language == "zh" else "stopped") in text and "service." not in text


def test_parameters_are_written_and_read(service: str) -> None:
    outcome = run_command(service, "write", *FAN, "F1.7=12.5", code=ExitCode.FAILED)
    assert outcome["error"]["key"] == "drives.not_described"
    outcome = run_command(service, "write", *FAN, "F1.10=1")
    assert outcome["outcome"] == "confirmed" and outcome["frames"]
    rows = run_command(service, "read", *FAN, "F1.10", "output_frequency")["values"]
    assert (rows[0]["notation"], rows[0]["value"]) == ("F1.10", 1.0)


def test_the_line_to_a_drive_is_tested_through_the_service(service: str) -> None:
    """Of the four manuals' functions only the loop-back of the VC660 needed the port of the service."""
    found = run_command(service, "loopback", "--drive", "pump-1", "--count", "5")
    assert (found["requests"], found["returned"], found["error"], found["complete"]) == (5, 5, None, True)
    assert 0 < found["round_trip_ms"]["min"] <= found["round_trip_ms"]["mean"] <= found["round_trip_ms"]["max"]
    assert "100" in run_command(service, "loopback", "--drive", "pump-1", "--count", "101", code=1)["error"]["text"]
    refused = run_command(service, "loopback", *FAN, code=ExitCode.FAILED)["error"]
    assert refused["type"] == "CapabilityError"


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_loopback_test_that_the_service_ends_names_the_time_limit(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    async def slow_test(drive: RemoteDrive, count: int) -> LoopbackReport:
        return LoopbackReport(3, (0.02,) * 2, 1, NoReply("bus.no_reply", station=1, milliseconds=56))

    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.OPERATOR))
    monkeypatch.setattr(RemoteDrive, "loopback_test", slow_test)
    words = ["loopback", "--service", plant.url, "--drive", "pump-1", "--lang", language]
    result = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    assert result.exit_code == ExitCode.FAILED
    assert result.stderr.strip() == i18n.text("loopback.time_limit", language, seconds=10)
    assert result.stdout.startswith(i18n.text("loopback.returned", language, returned=2, requests=3))


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupted_loopback_test_of_a_service_ends_at_once(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def endless_test(drive: RemoteDrive, count: int) -> LoopbackReport:
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(60)
        raise AssertionError("not cancelled")

    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.OPERATOR))
    monkeypatch.setattr(RemoteDrive, "loopback_test", endless_test)
    result = CliRunner().invoke(cli, ["loopback", "--service", plant.url, "--drive", "pump-1", "--lang", "en"])
    assert (result.exit_code, result.stdout) == (ExitCode.INTERRUPTED, "")
    assert result.stderr.strip() == i18n.text("scan.aborted")


def test_a_detached_run_a_new_setpoint_and_a_stop(plant: RunningService, service: str) -> None:
    words = ["run", "--service", service, *FAN, "--frequency", "20", "--detach", "--json"]
    done = CliRunner().invoke(cli, words)
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.exit_code == 0, done.output
    assert [event["event"] for event in events] == ["comm_loss", "started"]
    assert state(plant).driven
    assert run_command(service, "set-frequency", *FAN, "15")["outcome"] == "acknowledged"
    assert rest(plant, "/drives/fan-1")["lease"] is None
    stopped = run_command(service, "stop", *FAN)
    assert (stopped["outcome"], state(plant)) == ("confirmed", DriveState.STOPPED)


def test_a_pause_a_ramp_hold_and_a_stop(plant: RunningService, service: str) -> None:
    pump = ("--drive", "pump-1")
    words = ["run", "--service", service, *pump, "--frequency", "20", "--detach", "--json"]
    assert CliRunner().invoke(cli, words).exit_code == 0
    assert run_command(service, "hold-ramp", *pump, "0.2")["outcome"] == "acknowledged"
    assert run_command(service, "pause", *pump)["outcome"] == "confirmed"
    assert rest(plant, "/drives/pump-1")["state"] == "paused"
    refused = run_command(service, "hold-ramp", *pump, "1", code=ExitCode.FAILED)
    assert refused["error"]["key"] == "drives.state_forbids"
    assert run_command(service, "stop", *pump)["outcome"] == "confirmed"
    lacks = run_command(service, "pause", *FAN, code=ExitCode.FAILED)
    assert lacks["error"]["key"] == "drives.cannot"


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_run_at_0_hz_through_a_service_says_what_to_expect(service: str, language: str) -> None:
    words = ["run", "--service", service, *FAN, "--frequency", "0", "--detach", "--lang", language]
    done = CliRunner().invoke(cli, words, env={"COLUMNS": "300"})
    assert (done.exit_code, i18n.text("drives.run_at_zero", language) in done.output) == (0, True), done.output


def test_a_drive_that_a_service_runs_is_not_called_unsupervised_after_detaching(service: str) -> None:
    words = ["run", "--service", service, *FAN, "--frequency", "20", "--detach"]
    text = CliRunner().invoke(cli, words, env={"COLUMNS": "300"}).output
    assert i18n.text("run.detached_service", "en") in text and i18n.text("run.detached", "en") not in text


def test_ctrl_c_stops_the_drive_of_an_attached_run_and_releases_its_lease(plant: RunningService, service: str) -> None:
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.ENGINEER)
    with running_command("run", "--service", service, *FAN, "--frequency", "20", "--json") as process:
        lines = lines_until(process, lambda line: '"event": "status"' in line)
        assert json.loads(lines[0])["event"] == "started" and state(plant).turning
        assert rest(plant, "/drives/fan-1")["lease"] is not None
        process.send_signal(signal.SIGINT)
        last = lines_until(process, lambda line: '"stopped"' in line)[-1]
        assert process.wait(CHILD_TIMEOUT_S) == ExitCode.INTERRUPTED
    assert json.loads(last)["outcome"] == "confirmed"
    assert (state(plant), rest(plant, "/drives/fan-1")["lease"]) == (DriveState.STOPPED, None)


@pytest.mark.parametrize("by", ["bob", SERVICE_NAME, None])
def test_an_attached_run_tells_a_stop_through_the_service_from_one_at_the_drive(
    plant: RunningService, service: str, by: str | None
) -> None:
    """Regression: a stop by another user was called one of the keypad, the terminals or another master.

    One by the service itself, as of an interlock, was called one that ``drivebus`` requested.
    """

    async def stop() -> None:
        if by is None:
            plant.kit.station("fan-1").motor.stop()
        else:
            await plant.kit.call("drive.stop", remote_actor(by), drive="fan-1")

    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.ENGINEER)
    words = ("--frequency", "20", "--lang", "en")
    with running_command("run", "--service", service, *FAN, *words) as process:
        lines_until(process, lambda line: "Attached" in line)
        plant.run_in_loop(stop)
        shown = " ".join("".join(lines_until(process, lambda line: "no longer runs" in line)[-1:]).split())
        assert process.wait(CHILD_TIMEOUT_S) == ExitCode.FAILED
    keys = {None: "run.off_by_itself", SERVICE_NAME: "run.stopped_automatically"}
    expected = i18n.text(keys.get(by, "run.stopped_by"), actor=by)
    assert shown.endswith(expected)


@pytest.mark.parametrize(("kind", "stops"), [("trips", True), ("runs_on", False), ("unknown", None)])
def test_what_the_service_does_not_know_of_a_communication_loss_is_null(kind: str, stops: bool | None) -> None:
    class Client:
        async def call(self, operation: str, params: Any) -> Any:
            return {"comm_loss": {"kind": kind, "text": None}}

    drive = RemoteDrive(Client(), "fan-1", 1, None)  # type: ignore[arg-type]
    assert asyncio.run(drive.comm_loss_behaviour()).stops_on_comm_loss is stops


def test_a_name_that_only_the_service_does_not_know_is_reported_as_by_a_drive_on_a_bus() -> None:
    """The profile of the service may be another one than that of the command."""

    class Client:
        async def call(self, operation: str, params: Any) -> Any:
            unknown = ProfileError("profiles.unknown_name", model="c320", found="F0.1")
            return {"parameters": {}, "refused": {"F0.1": error_to_json(unknown)}}

    drive = RemoteDrive(Client(), "fan-1", 1, None)  # type: ignore[arg-type]
    with pytest.raises(ProfileError) as raised:
        asyncio.run(drive.read(["F0.1"]))
    assert raised.value.key == "profiles.unknown_name"


def test_a_quick_stop_over_a_service_is_the_drives_own_fast_stop() -> None:
    outcome = {"status": "confirmed", "text": {"en": "", "zh": ""}, "notes": [], "frames": []}

    class Client:
        async def call(self, operation: str, params: Any) -> Any:
            assert (operation, params) == ("drive.stop", {"drive": "fan-1", "how": "quick_stop"})
            return {"outcome": outcome}

    drive = RemoteDrive(Client(), "fan-1", 1, None)  # type: ignore[arg-type]
    assert asyncio.run(drive.quick_stop()).succeeded


def test_a_stop_that_is_not_confirmed_through_a_service_ends_with_4_and_its_sentence(
    plant: RunningService, service: str
) -> None:
    """The outcome in the error of the service was JSON: the command ended with a traceback and exit code 1."""

    async def set_silent(is_silent: bool) -> None:
        plant.kit.station("fan-1").faults.silent = is_silent
        while not is_silent and (await plant.kit.call("drives.get", drive="fan-1"))["stop_pending"]:  # noqa: ASYNC110
            await asyncio.sleep(0.05)

    plant.run_in_loop(lambda: set_silent(True))
    try:
        shown = CliRunner().invoke(cli, ["stop", "--service", service, *FAN, "--lang", "en"])
        found = run_command(service, "stop", *FAN, code=ExitCode.UNKNOWN)
    finally:
        plant.run_in_loop(lambda: set_silent(False))
    assert (shown.exit_code, shown.exception.__class__) == (ExitCode.UNKNOWN, SystemExit), shown.output
    assert "STOP NOT CONFIRMED" in shown.output and "Traceback" not in shown.output
    assert found["error"]["type"] == "StopUnconfirmed"


@pytest.mark.parametrize(
    "outcome",
    [
        {"status": "of a later version", "text": {"en": "", "zh": ""}, "notes": [], "frames": []},
        {"status": "unknown", "text": {"en": "", "zh": ""}, "notes": ["a"], "frames": []},
        {"status": "unknown", "text": "a", "notes": [], "frames": []},
        {},
        ["a"],
    ],
)
def test_an_outcome_in_the_form_of_another_version_is_unknown_and_followed_by_a_stop(outcome: Any) -> None:
    """Over HTTP it was a service that had not executed the start, on the socket a traceback."""
    superseded = Superseded("drives.superseded")
    superseded.outcome = outcome
    error = parse_error_outcome(superseded)
    assert (error.key, error.outcome.status) == ("drives.superseded", OutcomeStatus.UNKNOWN)
    assert must_stop_after(error) and error.outcome.note_texts() == []


def test_stop_all_stops_the_whole_plant(plant: RunningService, service: str) -> None:
    found = run_command(service, "stop", "--all")
    all_drives = sorted(plant.kit.service.plant.drives)
    assert (sorted(found["confirmed"]), found["unconfirmed"]) == (all_drives, [])
    for drive in all_drives:
        plant.run_in_loop(lambda drive=drive: plant.kit.call("start_inhibit.release", drive=drive))  # type: ignore[misc]


def test_stop_of_a_group_stops_its_drives_and_permits_their_start(plant: RunningService, service: str) -> None:
    found = run_command(service, "stop", "--group", "fans")
    assert (sorted(found["confirmed"]), found["unconfirmed"]) == (["fan-1", "fan-2"], [])
    assert {stop["status"] for stop in found["drives"].values()} == {"confirmed"}
    view = plant.run_in_loop(lambda: plant.kit.call("drives.get", drive="fan-1"))
    assert view["last_stop"]["kind"] == "group" and not view["start_inhibited"]
    assert run_command(service, "stop", "--group", "pumps", code=1)["error"]["key"] == "plant.no_group"


def test_stop_of_a_group_ends_with_4_where_a_drive_is_not_confirmed(
    plant: RunningService, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The outcome or error of each drive is printed, and the errors with their reason."""
    error = build_error_json("bus.no_reply", "NoReply", {"station": 2})

    async def stop_many(runtimes: Any, actor: Any) -> Any:
        return {"fan-1": {"status": "confirmed"}, "fan-2": error}

    monkeypatch.setattr(plant.kit.service.stops, "stop_many", stop_many)
    result = CliRunner().invoke(cli, ["stop", "--service", service, "--group", "fans", "--lang", "en"])
    assert result.exit_code == ExitCode.UNKNOWN
    assert "Stopped, confirmed: fan-1." in result.output and "check the drive locally: fan-2." in result.output
    assert f"fan-2: {error['text']['en']}" in " ".join(result.output.split())
    assert "drivebus release" not in result.output


def test_set_frequency_of_a_group_sets_each_drive_and_gives_the_control_back(
    plant: RunningService, service: str
) -> None:
    words = ["set-frequency", "--service", service, "--group", "fans", "12.5"]
    result = CliRunner().invoke(cli, [*words, "--json"])
    assert result.exit_code == 0, result.output
    found = {answer["drive"]: answer["outcome"] for answer in map(json.loads, result.stdout.splitlines())}
    assert found == {"fan-1": "acknowledged", "fan-2": "acknowledged"}
    assert [rest(plant, f"/drives/{drive}")["lease"] for drive in found] == [None, None]
    assert "fan-2: Acknowledged, can't be confirmed: " in CliRunner().invoke(cli, [*words, "--lang", "en"]).output
    assert "fan-2: 已应答，但无法确认：" in CliRunner().invoke(cli, [*words, "--lang", "zh"]).output


def test_set_frequency_of_a_group_is_not_sent_where_another_user_has_control_of_a_drive(
    plant: RunningService, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engineer = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-2/lease", headers=engineer).raise_for_status()
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.OPERATOR))
    refused = run_command(plant.url, "set-frequency", "--group", "fans", "11", code=1)["error"]
    assert (refused["key"], refused["params"]["drive"]) == ("plant.not_owner", "fan-2")
    assert rest(plant, "/drives/fan-1")["lease"] is None, "the control that was taken before it"
    assert run_command(service, "set-frequency", "--group", "pumps", "11", code=1)["error"]["key"] == "plant.no_group"


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (build_error_json("drives.state_forbids", "StartInhibited", {}), ExitCode.FAILED),
        (build_error_json("service.lost", "OutcomeUnknown", {}), ExitCode.UNKNOWN),
        ({"status": "unknown"}, ExitCode.UNKNOWN),
        ({"status": "failed"}, ExitCode.FAILED),
    ],
)
def test_set_frequency_of_a_group_ends_with_the_worst_outcome(
    plant: RunningService, service: str, monkeypatch: pytest.MonkeyPatch, answer: Any, code: int
) -> None:
    set_one = plant.kit.service.commands.set_drive_frequency

    async def fail_for_fan_2(drive: Any, *rest: Any) -> Any:
        found = await set_one(drive, *rest)
        return found if drive.id != "fan-2" else found | answer if "status" in answer else answer

    monkeypatch.setattr(plant.kit.service.commands, "set_drive_frequency", fail_for_fan_2)
    words = ["set-frequency", "--service", service, "--group", "fans", "12.5", "--lang", "en"]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == code, result.output
    assert "fan-1: Acknowledged" in result.output and "\nfan-2: " in result.output
    assert "fan-2: Acknowledged" not in result.output


def test_a_limit_has_the_same_error_and_exit_code_through_a_service_and_on_a_port(service: str) -> None:
    on_port = CliRunner().invoke(
        cli, ["set-frequency", "sim://c320@1", "60", "--model", "c320", "--address", "1", "--json"]
    )
    on_service = run_command(service, "set-frequency", *FAN, "60", code=on_port.exit_code)
    error = json.loads(on_port.stdout)["error"]
    assert [on_service["error"][name] for name in ("type", "key", "text")] == [
        error[name] for name in ("type", "key", "text")
    ]


def test_a_command_needs_the_lease_and_keeps_that_of_its_own_session(
    plant: RunningService, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lease that the session had before stays; the lease of another user is an error."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.OPERATOR))
    headers = {"Authorization": f"Bearer {token(Role.OPERATOR)}"}
    httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=headers).raise_for_status()
    if service == plant.url:
        run_command(service, "set-frequency", *FAN, "10")
        assert rest(plant, "/drives/fan-1")["lease"]["owner"] == "operator/test"
        engineer = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
        httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=engineer).raise_for_status()
        refused = run_command(service, "set-frequency", *FAN, "10", code=ExitCode.FAILED)
        assert refused["error"]["key"] == "plant.not_owner"
        assert rest(plant, "/drives/fan-1")["lease"]["owner"] == "engineer/test"
    else:
        monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    stopped = run_command(service, "stop", *FAN)
    assert stopped["outcome"] == "confirmed"


def test_a_viewer_can_only_read(plant: RunningService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.VIEWER))
    run_command(plant.url, "status", *FAN)
    for words in (["stop", *FAN], ["set-frequency", *FAN, "10"], ["write", *FAN, "F1.10=1"], ["stop", "--all"]):
        found = run_command(plant.url, words[0], *words[1:], code=ExitCode.FAILED)
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
        (["stop", "--group", "fans", "--service", "x", "--address", "1"], "service.not_with"),
        (["stop", "--group", "fans", "--service", "x", "--dry-run"], "service.not_with"),
        (["stop", "--group", "fans"], "service.group_alone"),
        (["set-frequency", "--group", "fans", "--service", "x", *FAN, "5"], "service.drive_or_group"),
        (["set-frequency", "--group", "fans", "--service", "x", "5", "--dry-run"], "service.not_with"),
        (["set-frequency", "--group", "fans", "--service", "x", "5", "--baud", "9600"], "service.not_with"),
        (
            ["set-frequency", "sim://c320@1", "5", "--model", "c320", "--address", "1", "--group", "fans"],
            "service.group_alone",
        ),
        (["stop", "plant.toml", "--group", "fans"], "service.group_alone"),
        (["set-frequency", "--group", "fans", "20"], "service.group_alone"),
        (["run", *FAN, "--frequency", "20"], "service.drive_alone"),
        (["coast", *FAN], "service.drive_alone"),
        (["status", *FAN], "service.drive_alone"),
        (["stop", "--group", "fans", "--all", "--service", "x"], "stop_all.one_selection"),
        (["stop", "--group", "fans", *FAN, "--service", "x"], "stop_all.one_selection"),
        (["stop", "--all", *FAN, "--service", "x"], "stop_all.one_selection"),
        (["stop", "--group", "fans", "--assume-model", "--service", "x"], "stop_all.not_assumed"),
        (["monitor", "--service", "x", "--record", "a.dbcap"], "service.not_with"),
        (["status", "--service", "ftp://127.0.0.1", *FAN], "service.address"),
        (["status", "--service", "http://a:b@127.0.0.1", *FAN], "service.address"),
        (["status", "--service", "http://127.0.0.1:99999", *FAN], "service.address"),
        (["stop", "--service", "state/stop.sock", *FAN], "service.address"),
        (["status", "--service", "http://10.0.0.7", *FAN], "service.not_secret"),
    ],
)
def test_contradictory_options_are_a_usage_error(words: list[str], key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    result = CliRunner().invoke(cli, [*words, "--json"])
    assert (result.exit_code, json.loads(result.stdout)["error"]["key"]) == (ExitCode.USAGE, key)
    assert "--addresses" not in result.stdout, "the name of the option as it is typed"


@pytest.mark.parametrize(("value", "key"), [(None, "service.no_token"), ("a\nb", "service.token")])
def test_without_a_valid_token_nothing_is_sent(monkeypatch: pytest.MonkeyPatch, value: str | None, key: str) -> None:
    monkeypatch.delenv("DRIVEBUS_TOKEN", raising=False)
    if value is not None:
        monkeypatch.setenv("DRIVEBUS_TOKEN", value)
    assert run_command("http://127.0.0.1:1", "status", *FAN, code=ExitCode.USAGE)["error"]["key"] == key


def test_a_service_that_cannot_be_reached_is_an_error_before_anything_is_sent(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    assert (
        run_command("http://127.0.0.1:1", "status", *FAN, code=ExitCode.FAILED)["error"]["key"] == "service.not_there"
    )
    assert (
        run_command(str(tmp_path / "plant.sock"), "status", *FAN, code=ExitCode.FAILED)["error"]["key"]
        == "plant.not_there"
    )


def test_a_socket_in_the_current_directory_needs_no_suffix(
    plant: RunningService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pumps").symlink_to(plant.socket)
    assert run_command("pumps", "status", *FAN)["model"] == "c320"


class MisbehavingHandler(BaseHTTPRequestHandler):
    """Server that responds to GET as a service does, and to POST with ``respond``."""

    respond: Callable[[MisbehavingHandler], None]

    def do_GET(self) -> None:
        self._send(200, {"model": "c320", "address": 1, "lease": None})

    def do_POST(self) -> None:
        type(self).respond(self)

    def _send(self, status: int, document: Any, **headers: str) -> None:
        body = json.dumps(document).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        return


@pytest.fixture
def misbehaving_service(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("DRIVEBUS_TOKEN", "t")
    server = HTTPServer(("127.0.0.1", 0), MisbehavingHandler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_missing_response_is_an_unknown_outcome(misbehaving_service: str) -> None:
    """The exit code is 4: the stop may have been executed."""
    MisbehavingHandler.respond = lambda self: self.connection.close()  # type: ignore[method-assign]
    assert (
        run_command(misbehaving_service, "stop", *FAN, code=ExitCode.UNKNOWN)["error"]["type"]
        == OutcomeUnknown.__name__
    )


@pytest.mark.parametrize(
    ("status", "document"),
    [
        (503, build_error_json("plant.internal", "ServiceUnavailable", {})),
        (500, build_error_json("api.unforeseen", "InternalError", {})),
        (504, None),
    ],
    ids=["service", "gateway", "proxy"],
)
def test_a_start_that_a_service_or_a_proxy_failed_to_answer_has_an_unknown_outcome(
    misbehaving_service: str, monkeypatch: pytest.MonkeyPatch, status: int, document: Any
) -> None:
    """It was a failure that had moved nothing, so that no stop followed."""
    stops: list[str] = []

    def respond(self: MisbehavingHandler) -> None:
        if self.path.endswith("/lease"):
            self._send(200, {"lease": {"session": "s"}})
        elif self.path.endswith("/arm"):
            self._send(200, {"arm_token": "t"})
        elif self.path.endswith("/stop"):
            stops.append(self.path)
            self.connection.close()
        else:
            self._send(status, "Gateway Time-out" if document is None else {"error": document})

    MisbehavingHandler.respond = respond  # type: ignore[method-assign]
    monkeypatch.setattr(MisbehavingHandler, "do_DELETE", lambda self: self._send(200, {}), raising=False)
    result = CliRunner().invoke(cli, ["run", "--service", misbehaving_service, *FAN, "--frequency", "5", "--json"])
    assert (result.exit_code, len(stops)) == (ExitCode.UNKNOWN, 1), result.output


def test_a_service_sends_no_escape_sequences_to_the_terminal(
    misbehaving_service: str,
) -> None:
    evil = "\x1b]0;taken over\x07\u202e\x9b2J"
    refusal = {
        "code": evil,
        "kind": "Conflict",
        "text": {"en": evil, "zh": evil},
        "params": {evil: [evil]},
        "outcome": None,
    }
    MisbehavingHandler.respond = lambda self: self._send(409, {"error": refusal})  # type: ignore[method-assign]
    shown = CliRunner().invoke(cli, ["stop", *FAN, "--service", misbehaving_service])
    assert "taken over" in shown.output
    assert not set(shown.output) & {"\x1b", "\x07", "\u202e", "\x9b"}
    assert http_client.printable_values({"text": ["two\n\tlines", 1, None]}) == {"text": ["two\n\tlines", 1, None]}


def test_a_redirect_is_not_followed_with_the_token(misbehaving_service: str) -> None:
    MisbehavingHandler.respond = lambda self: self._send(307, {}, Location="http://127.0.0.1:1/")  # type: ignore[method-assign]
    assert (
        run_command(misbehaving_service, "stop", "--all", code=ExitCode.UNKNOWN)["error"]["key"]
        == "service.not_stopped"
    )


def test_the_live_view_shows_the_drives_offline_when_the_service_is_lost(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.VIEWER))
    shown = CliRunner().invoke(cli, ["monitor", "--service", plant.url, "--json", "--duration", "0.2"])
    first = next(view for view in map(json.loads, shown.stdout.splitlines()) if "drives" in view)
    assert [drive["drive"] for drive in first["drives"]] == ["fan-1", "fan-2", "pump-1", "pump-2"], shown.output
    source = ServiceRowSource(plant.url)
    source._drives = [_row(plant)]
    source._mark_unreachable(ConfigurationError("service.token"))
    assert (source.drives()[0].presence, source.drives()[0].readings, len(source.messages())) == ("offline", {}, 2)


def _row(plant: RunningService) -> Any:
    from drivebus.cli.tui.service_source import remote_drive_row

    return remote_drive_row(rest(plant, "/drives/fan-1"), 0.0)


def test_the_error_of_an_invalid_cursor_has_all_its_parameters(plant: RunningService) -> None:
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    response = httpx.get(f"{plant.url}{API_PREFIX}/audit", params={"cursor": "x"}, headers=headers)
    error = response.json()["error"]
    assert (response.status_code, error["params"]["operation"]) == (422, "audit.list")
    assert "{" not in error["text"]["en"] and "cursor" in error["text"]["zh"]


def test_release_permits_starts_again_after_a_bus_stop(plant: RunningService, service: str) -> None:
    run_command(service, "stop", "--all")
    refused = run_command(service, "write", "F1.10=16", *FAN, code=1)
    assert refused["error"]["key"] == "drives.start_inhibited" and "drivebus release" in refused["error"]["hint"]
    assert run_command(service, "release", *FAN) == {"released": "fan-1"}
    assert plant.run_in_loop(lambda: plant.kit.call("drives.get", drive="fan-1"))["lease"] is None
    result = CliRunner().invoke(cli, ["release", "--service", service, "--all", "--json"])
    others = sorted(set(plant.kit.service.plant.drives) - {"fan-1"})
    assert [json.loads(line)["released"] for line in result.stdout.splitlines()] == others
    assert run_command(service, "release", "--all") == {"released": None}
    run_command(service, "reset", *FAN)


def test_equal_refusals_of_several_drives_are_one_sentence_with_their_names(
    plant: RunningService, service: str
) -> None:
    run_command(service, "stop", "--all")
    other = remote_actor("bob")
    for drive in ("fan-1", "fan-2"):
        plant.run_in_loop(lambda drive=drive: plant.kit.call("lease.take", other, drive=drive))  # type: ignore[misc]
    result = CliRunner().invoke(cli, ["release", "--service", service, "--all", "--json"])
    *released, refused = map(json.loads, result.stdout.splitlines())
    assert result.exit_code == 1 and [answer["released"] for answer in released] == ["pump-1", "pump-2"]
    assert refused["refused"] == ["fan-1", "fan-2"] and refused["error"] == "bob has control of fan-1, fan-2"
    for drive in ("fan-1", "fan-2"):
        plant.kit.service.plant.leases.remove_drive(drive)
    assert CliRunner().invoke(cli, ["release", "--service", service, "--group", "fans"]).exit_code == 0
    assert run_command(service, "release", code=2)["error"]["key"] == "release.which"


def test_waive_records_a_waiver_for_each_drive_of_a_group_that_has_none(plant: RunningService, service: str) -> None:
    plant.run_in_loop(lambda: plant.kit.call("waiver.revoke", drive="fan-2"))
    assert run_command(service, "waive", "--group", "fans", "--reason", "watched bench") == {"waived": "fan-2"}
    assert run_command(service, "waive", "--all", "--reason", "watched bench") == {"waived": None}
    assert rest(plant, "/drives/fan-2")["comm_loss"]["waiver"].startswith("watched bench")


@pytest.mark.parametrize("name", ["fan-9", "Fan-1", "送风机"])
def test_an_unknown_drive_is_answered_with_those_that_exist(plant: RunningService, service: str, name: str) -> None:
    """A title or a capital letter was answered with a regular expression."""
    for command in ("status", "stop"):
        error = run_command(service, command, "--drive", name, code=1)["error"]
        assert error["key"] == "plant.no_drive"
        assert all(drive in error["text"] for drive in (name, *plant.kit.service.plant.drives))


def test_a_request_for_control_that_no_session_has_says_that_a_command_takes_it(
    plant: RunningService, service: str
) -> None:
    words = ["control", "request", "--service", service, "--drive", "fan-1", "--json", "--lang", "en"]
    error = json.loads(CliRunner().invoke(cli, words).stdout)["error"]
    assert (error["key"], "take control themselves" in (error["hint"] or "")) == ("plant.control_is_free", True)


def test_comm_loss_test_records_a_trip_and_tells_success_by_its_exit_code(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    monkeypatch.setattr(comm_loss_test, "TURNING_TIME_S", 0.2)
    monkeypatch.setattr(comm_loss_test, "LAST_POLLS_S", 0.1)
    arguments = ("--drive", "fan-2", "--frequency", "5", "--silence", "2")
    assert "--yes" in run_command(plant.url, "comm-loss-test", *arguments, code=2)["error"]["text"]
    plant.run_in_loop(lambda: _set_keypad(plant, {0x9_03: 2, 0x9_04: 10}))
    words = ["comm-loss-test", "--service", plant.url, *arguments, "--yes", "--lang", "en"]
    result = CliRunner().invoke(cli, words, env={"COLUMNS": "200"})
    tested = rest(plant, "/drives/fan-2")["comm_loss"]["tested"]
    shown = {"drive": "fan-2", "fault": tested["fault"], "seconds": f"{tested['silence_s']:g}"}
    assert result.exit_code == 0 and i18n.text("comm_loss_test.trips", "en", **shown) in result.stdout
    assert tested["result"] == "trips" and tested["parameters"] == {"F9.3": 2, "F9.4": 10}
    assert plant.run_in_loop(lambda: plant.kit.call("drives.get", drive="fan-2"))["lease"] is None
    plant.run_in_loop(lambda: plant.kit.call("drive.reset", drive="fan-2"))


@pytest.mark.parametrize("is_error_output", [True, False])
def test_comm_loss_test_goes_on_where_its_output_can_t_be_written(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch, is_error_output: bool
) -> None:
    """It ended while the service went on with the motor running, or with 2 after its result."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    monkeypatch.setattr(comm_loss_test, "ACCELERATION_TIMEOUT_S", 0.2)
    echo = output.click.echo

    def fail(text: str, err: bool = False, **more: Any) -> None:
        if err is is_error_output:
            raise OSError(28, "No space left on device")
        echo(text, err=err, **more)

    monkeypatch.setattr(output.click, "echo", fail)
    words = ["comm-loss-test", "--service", plant.url, "--drive", "fan-2", "--frequency", "5", "--yes", "--json"]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 1
    if is_error_output:
        assert json.loads(result.stdout)["event"] == "comm_loss_test"


@pytest.mark.parametrize(("status", "code"), [(OutcomeStatus.CONFIRMED, 130), (OutcomeStatus.UNKNOWN, 4)])
def test_comm_loss_test_that_ctrl_c_ends_says_how_its_stop_ended(
    monkeypatch: pytest.MonkeyPatch, status: OutcomeStatus, code: int
) -> None:
    """It ended without a word while it was not known whether the motor had stopped."""

    class Client:
        @staticmethod
        async def call(*_: Any) -> Any:
            return {"address": 1, "model": "c320", "comm_loss": {"tested": None, "test": {}}}

    @asynccontextmanager
    async def open_client(_: str) -> AsyncIterator[Client]:
        yield Client()

    @contextmanager
    def ctrl_c(**_: Any) -> Iterator[ShutdownSignal]:
        shutdown = ShutdownSignal()
        shutdown.request("SIGINT")
        yield shutdown

    async def started(*_: Any) -> Any:
        return {"silence_s": 2.0}

    async def stop(*_: Any, **__: Any) -> Outcome:
        return Outcome(status=status, key="bus.closed")

    monkeypatch.setattr("drivebus.cli.remote.client.open_client", open_client)
    monkeypatch.setattr("drivebus.cli.signals.shutdown_signals", ctrl_c)
    monkeypatch.setattr(RemoteDrive, "test_comm_loss", started)
    monkeypatch.setattr(RemoteDrive, "stop", stop)
    words = ["comm-loss-test", "--service", "http://127.0.0.1:1", "--drive", "fan-2", "--frequency", "5", "--yes"]
    result = CliRunner().invoke(cli, [*words, "--json"])
    stopped = json.loads(result.stdout)
    assert (result.exit_code, stopped["event"], stopped["outcome"]) == (code, "stopped", str(status)), result.output


@pytest.mark.parametrize(
    ("result", "key", "code"),
    [
        (None, "comm_loss_test.nothing", 1),
        ("stops", "comm_loss_test.stops", 0),
        ("runs_on", "comm_loss_test.runs_on", 1),
    ],
)
def test_comm_loss_test_names_the_result_that_was_recorded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], result: str | None, key: str, code: int
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    tested = None if result is None else {"result": result, "silence_s": 6.0, "fault": None, "time_ms": 5}
    assert comm_loss_test_command._print_result("fan-2", {"tested": tested, "no_result": None}, None) == code
    assert capsys.readouterr().out.strip() == i18n.text(key, "en", drive="fan-2", seconds="6", fault="-")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_comm_loss_test_gives_the_reason_where_no_result_was_recorded(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    """Regression: it pointed to the events of the service; the record of an earlier test is no result of this one."""
    monkeypatch.setenv("DRIVEBUS_TOKEN", token(Role.ENGINEER))
    monkeypatch.setattr(comm_loss_test, "ACCELERATION_TIMEOUT_S", 0.2)
    words = ["comm-loss-test", "--service", plant.url, "--drive", "fan-2", "--frequency", "5", "--yes"]
    result = CliRunner().invoke(cli, [*words, "--lang", language], env={"COLUMNS": "200"})
    why = i18n.text("plant.comm_loss_not_turning", language, drive="fan-2")
    assert result.exit_code == 1 and i18n.text("plant.comm_loss_void", language, why=why) in result.stdout, (
        result.output
    )
    before = {"result": "trips", "silence_s": 6.0, "fault": None, "time_ms": 5}
    found = {"tested": before, "no_result": {"en": "WHY", "zh": "WHY"}}
    assert comm_loss_test_command._print_result("fan-2", found, before) == ExitCode.FAILED


async def _set_keypad(plant: RunningService, values: dict[int, int]) -> None:
    for place, raw in values.items():
        plant.kit.station("fan-2").keypad_set(place, raw)
