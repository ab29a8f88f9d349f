"""``drivebus control``: one command controls a drive, another asks for it; over HTTP and over the socket."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any, cast

import httpx
import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli.commands import control
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.cli.remote.client import RemoteClient
from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.actor import local_user
from drivebus.service.auth.rights import Role
from fixtures.child_process import CHILD_TIMEOUT_S, ENVIRONMENT, PtyTerminal, lines_until, running_command
from fixtures.running_service import RunningService, plant_fixture, token
from fixtures.service import remote_actor

FAN = ("--drive", "fan-1")
BOB = remote_actor("bob")


plant = plant_fixture(grants_waivers=True)


@pytest.fixture(autouse=True)
def no_leases(plant: RunningService) -> Iterator[None]:
    """Begin without leases and requests, and without the pause before a next request."""
    yield
    plant_control = plant.kit.service.plant
    plant.run_in_loop(lambda: plant.kit.call("drive.stop", drive="fan-1"))
    plant_control.leases.remove_drive("fan-1")
    plant_control.control_requests.remove_drive("fan-1")
    plant_control.control_requests._requested_at.clear()


def view(plant: RunningService) -> Any:
    return plant.run_in_loop(lambda: plant.kit.call("drives.get", drive="fan-1"))


def wait_for(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + CHILD_TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.05)


def asked(plant: RunningService, state: str = "open") -> bool:
    request = view(plant)["control_request"]
    return request is not None and request["state"] == state


def answer(word: str, plant: RunningService, code: int = 0, service: str | None = None) -> Any:
    """Answer with the engineer's token; on the socket as the user of this machine."""
    words = ["control", word, "--service", service or plant.url, *FAN, "--json"]
    result = CliRunner().invoke(cli, words, env={"DRIVEBUS_TOKEN": token(Role.ENGINEER)})
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)


def asking(service: str, *words: str) -> Any:
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.OPERATOR)
    return running_command("control", "request", "--service", service, *FAN, "--json", *words)


def grant_by_bob(plant: RunningService) -> None:
    """Let the user who controls the drive hand it over to the one who asks."""
    wait_for(lambda: asked(plant))
    request = view(plant)["control_request"]["id"]
    plant.run_in_loop(lambda: plant.kit.call("control_request.grant", BOB, drive="fan-1", request=request))


def result_of(process: subprocess.Popen[str]) -> Any:
    """Return the answer that the command printed."""
    return json.loads(lines_until(process, lambda line: '"control"' in line)[-1])


@pytest.mark.parametrize("transport", ["http", "socket"])
def test_an_attached_run_names_who_asks_and_ends_without_a_stop_once_a_second_terminal_hands_control_over(
    plant: RunningService, transport: str
) -> None:
    """On the socket each terminal has a session of its own, and the answer is that of the same user."""
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.ENGINEER)
    service, owner = (plant.url, "engineer/test") if transport == "http" else (str(plant.socket), local_user())
    with running_command("run", "--service", service, *FAN, "--frequency", "20", "--json") as holder:
        lines_until(holder, lambda line: '"event": "status"' in line)
        stops = plant.kit.service.plant.stop_statistics.requested
        with asking(plant.url, "--reason", "belt is slipping") as asker:
            wait_for(lambda: asked(plant))
            assert holder.stderr is not None
            note = next(line for line in holder.stderr if "asks you for control" in line)
            assert note.startswith("operator/test asks you for control of fan-1: belt is slipping")
            assert answer("grant", plant, service=service) == {"drive": "fan-1", "user": "operator/test"}
            assert result_of(asker) == {"control": "granted", "drive": "fan-1", "by": owner}
            assert asker.wait(CHILD_TIMEOUT_S) == ExitCode.DONE
        assert holder.wait(CHILD_TIMEOUT_S) == ExitCode.FAILED
        assert i18n.text("run.control_lost") in " ".join(holder.stderr.read().split())
    found = view(plant)
    assert found["lease"]["owner"] == "operator/test" and found["state"] in ("running", "accelerating")
    assert plant.kit.service.plant.stop_statistics.requested == stops, "the end of the run stopped the motor"


def test_a_declined_request_is_exit_code_1_and_without_a_request_there_is_nothing_to_answer(
    plant: RunningService,
) -> None:
    assert answer("decline", plant, code=ExitCode.FAILED)["error"]["key"] == "plant.no_control_request"
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    taken = httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=headers)
    assert taken.status_code == 200
    with asking(plant.url) as asker:
        wait_for(lambda: asked(plant))
        answer("decline", plant)
        assert result_of(asker)["control"] == "declined"
        assert asker.wait(CHILD_TIMEOUT_S) == ExitCode.FAILED


def test_a_request_is_made_and_granted_where_the_output_of_both_commands_is_lost(
    plant: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ended with 2, as if nothing had been asked or granted."""
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    assert httpx.post(f"{plant.url}{API_PREFIX}/drives/fan-1/lease", headers=headers).status_code == 200

    def fail(text: str, err: bool = False, **_: Any) -> None:
        raise BrokenPipeError

    with asking(plant.url) as asker:
        assert asker.stdout is not None
        asker.stdout.close()
        wait_for(lambda: asked(plant))
        monkeypatch.setattr("drivebus.cli.output.click.echo", fail)
        words = ["control", "grant", "--service", plant.url, *FAN]
        assert CliRunner().invoke(cli, words, env={"DRIVEBUS_TOKEN": token(Role.ENGINEER)}).exit_code == 0
        assert asker.wait(CHILD_TIMEOUT_S) == ExitCode.DONE
    assert asked(plant, "granted")


async def test_ctrl_c_before_the_reply_withdraws_the_request() -> None:
    """The request stayed open although the command that asked had ended."""
    calls, reply = list[str](), asyncio.Event()

    class SlowClient:
        async def call(self, operation: str, _: Any) -> Any:
            calls.append(operation)
            await reply.wait()

    asking = asyncio.ensure_future(control._ask(cast("RemoteClient", SlowClient()), "fan-1", None))
    await asyncio.sleep(0)
    asking.cancel()
    await asyncio.sleep(0)
    reply.set()
    with pytest.raises(asyncio.CancelledError):
        await asking
    assert calls == ["control_request.make", "control_request.withdraw"]


def test_ctrl_c_withdraws_the_request(plant: RunningService) -> None:
    plant.run_in_loop(lambda: plant.kit.call("lease.take", BOB, drive="fan-1"))
    with asking(plant.url) as asker:
        wait_for(lambda: asked(plant))
        asker.send_signal(signal.SIGINT)
        asker.wait(CHILD_TIMEOUT_S)
    assert asked(plant, "withdrawn")


@pytest.mark.parametrize("transport", ["socket", "hold"])
def test_control_is_released_for_the_next_command_on_the_socket_and_held_until_ctrl_c_with_hold(
    plant: RunningService, transport: str
) -> None:
    plant.run_in_loop(lambda: plant.kit.call("lease.take", BOB, drive="fan-1"))
    service, more = (str(plant.socket), ()) if transport == "socket" else (plant.url, ("--hold",))
    with asking(service, *more) as asker:
        grant_by_bob(plant)
        assert result_of(asker)["control"] == "granted"
        if transport == "hold":
            wait_for(lambda: plant.kit.service.plant.leases._leases["fan-1"].claimed)
            asker.send_signal(signal.SIGINT)
        asker.wait(CHILD_TIMEOUT_S)
    assert view(plant)["lease"] is None


@pytest.mark.parametrize(
    ("transport", "sentence"), [("http", "ends in ten seconds"), ("socket", "your next command takes it")]
)
def test_a_granted_request_says_how_long_control_lasts(plant: RunningService, transport: str, sentence: str) -> None:
    plant.run_in_loop(lambda: plant.kit.call("lease.take", BOB, drive="fan-1"))
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.OPERATOR)
    service = plant.url if transport == "http" else str(plant.socket)
    with running_command("control", "request", "--service", service, *FAN) as asker:
        grant_by_bob(plant)
        assert sentence in lines_until(asker, lambda line: "handed control" in line)[-1]


def test_a_command_that_holds_control_says_until_when_and_who_asks_for_it_meanwhile(plant: RunningService) -> None:
    """Its sentence was that control ends in ten seconds, and no request of another user was printed."""
    plant.run_in_loop(lambda: plant.kit.call("lease.take", BOB, drive="fan-1"))
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.OPERATOR)
    with running_command("control", "request", "--service", plant.url, *FAN, "--hold") as holder:
        grant_by_bob(plant)
        assert "until Ctrl-C" in lines_until(holder, lambda line: "handed control" in line)[-1]
        request = {"drive": "fan-1", "reason": "tool change"}
        plant.run_in_loop(lambda: plant.kit.call("control_request.make", BOB, **request))
        assert holder.stderr is not None
        note = next(line for line in holder.stderr if "asks you for control" in line)
        assert note.startswith("bob asks you for control of fan-1: tool change")
        holder.send_signal(signal.SIGINT)
        holder.wait(CHILD_TIMEOUT_S)


def test_a_request_stands_on_a_line_of_its_own_below_the_live_line_of_a_run(plant: RunningService) -> None:
    """It was appended to the state: ``bus 537 Vbob asks you for control``."""
    ENVIRONMENT["DRIVEBUS_TOKEN"] = token(Role.ENGINEER)
    with PtyTerminal("run", "--service", plant.url, *FAN, "--frequency", "20") as terminal:
        terminal.wait_for("20.00 Hz")
        plant.run_in_loop(lambda: plant.kit.call("control_request.make", BOB, drive="fan-1", reason=None))
        terminal.wait_for("asks you for control")
        assert "\nbob asks you for control of fan-1" in terminal.output
        terminal.press("\x03")
        terminal.exit_code()
