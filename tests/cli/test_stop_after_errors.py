"""A stop follows a failed command where its frame may have left the motor running, and only there.

Errors of every class take the place of one transaction, or of one answer of a service.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus import errors, i18n, profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.cli import connect
from drivebus.cli.commands import calibrate, comm_loss_test, run
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import must_stop_after
from drivebus.cli.errors import ExitCode
from drivebus.cli.remote.drive import RemoteBus, RemoteDrive
from drivebus.cli.remote.unknown_outcome import LOST_KEYS, outcome_unknown_on_loss
from drivebus.cli.signals import ShutdownSignal
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.errors import (
    ControlNotHeld,
    DrivebusError,
    DriveRejected,
    OutcomeUnknown,
    ServiceError,
    ServiceUnavailable,
    TargetNotReached,
)
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.service.api.errors import error_from_json, error_to_json, outcome_json
from drivebus.simulator.port import clear_simulated_buses
from drivebus.testing import virtual_time
from drivebus.types import Json
from fixtures.drives import MODELS, SAFE_HZ, FakeC320, reject_command

CLASSES = tuple(kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, DrivebusError))
KEY = "bus.no_reply"
CALIBRATED = {"dzb100": "setpoint_coding", "df800": "direction"}


@pytest.fixture(autouse=True)
def attached(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """End each run that has started, as Ctrl-C does."""

    async def interrupted(*_: object) -> ExitCode:
        return ExitCode.INTERRUPTED

    monkeypatch.setattr(run, "_watch", interrupted)
    yield
    clear_simulated_buses()


class Script:
    """Script of one command: its transactions, and an error or a reply in place of one of them.

    ``place``: the error is raised ``before`` the acting frame, or ``after`` it; it is the result of the acting frame,
    which was ``sent`` or ``unsent``; or the drive has ``rejected`` that.
    """

    def __init__(self, place: str, error: Exception | None = None, reply: Any = None, acting: Effect = Effect.MOTION):
        self.place, self.error, self.reply, self.acting = place, error, reply, acting
        self.effects: list[Effect] = []
        """Effects of the frames that left."""
        self.is_due = True

    @property
    def has_acted(self) -> bool:
        return self.acting in self.effects

    @property
    def has_stopped(self) -> bool:
        return Effect.STOP in self.effects

    def submit(self, asked: BusRequest, effect: Effect, send: Callable[[BusRequest], Any]) -> Any:
        at_place = {"before": not self.has_acted, "after": self.has_acted}.get(self.place, effect is self.acting)
        if not self.is_due or effect is Effect.STOP or not at_place:
            self.effects.append(effect)
            return send(asked)
        self.is_due = False
        if self.place in ("before", "after"):
            assert self.error is not None
            raise self.error
        if self.place == "sent":
            send(asked)
        if self.place != "unsent":
            self.effects.append(effect)
        future = asyncio.get_running_loop().create_future()
        sent = b"" if self.place == "unsent" else b"\x01"
        future.set_result(BusResult(bus_request=asked, reply=self.reply, error=self.error, sent=sent, attempts=1))
        return future


def play(script: Script, command: Callable[[], Awaitable[Any]]) -> Any:
    """Return the result of a command whose transactions follow a script, or the error that it ends with."""
    submit = Bus.submit

    def follow(self: Bus, asked: BusRequest) -> Any:
        config = self.core.stations[asked.station].config
        effect = config.effect_of(config.codec.encode_request(asked.request))
        return script.submit(asked, effect, lambda asked: submit(self, asked))

    async def follow_and_wait(self: Bus, asked: BusRequest) -> BusResult:
        return await follow(self, asked)

    async def played() -> Any:
        try:
            return await command()
        except Exception as error:
            return error

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bus, "submit", follow)
        patch.setattr(Bus, "transact", follow_and_wait)
        return virtual_time.run(played())


def target_of(model: str) -> Target:
    return Target(port=f"sim://{model}@1?ramp=1&name=errors", model=model, address=1)


def run_command(model: str, frequency_hz: float | None = None) -> Awaitable[ExitCode]:
    return run._run(target_of(model), frequency_hz or SAFE_HZ[model], reverse=False, wait=False, detach=False)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("place", "stops"), [("before", False), ("unsent", False), ("sent", True), ("after", True)])
def test_a_failed_run_is_followed_by_a_stop_only_where_its_start_may_have_left(
    capsys: pytest.CaptureFixture[str], model: str, place: str, stops: bool
) -> None:
    for kind in CLASSES:
        script = Script(place, kind(KEY))
        found = play(script, lambda: run_command(model))
        assert (script.has_acted, script.has_stopped) == (stops, stops), kind
        assert isinstance(found, ExitCode if stops else DrivebusError), kind
        stop_outcome = capsys.readouterr().out.partition(i18n.text("run.stopping", "en"))[2]
        assert bool(stop_outcome.strip()) is stops
        clear_simulated_buses()


@pytest.mark.parametrize("place", ["before", "after"])
@pytest.mark.parametrize("error", [RuntimeError("a bug"), OSError(5, "the terminal is gone")])
def test_an_exception_that_no_drive_has_marked_is_followed_by_a_stop(error: Exception, place: str) -> None:
    script = Script(place, error)
    play(script, lambda: run_command("c320"))
    assert script.has_stopped


@pytest.mark.parametrize(
    ("model", "reply"),
    [
        ("c320", reject_command(FakeC320(), None)),
        ("vc660", modbus.ExceptionReply(1, 6, 4)),
        ("df800", modbus.ExceptionReply(1, 6, None)),
    ],
)
def test_a_start_that_the_drive_has_rejected_is_followed_by_no_stop(model: str, reply: Any) -> None:
    script = Script("rejected", reply=reply)
    found = play(script, lambda: run_command(model))
    assert isinstance(found, DriveRejected) and found.key == "drives.start_refused"
    assert script.has_acted and not script.has_stopped


@pytest.mark.parametrize(("code", "stops"), [(1, False), (4, False), (5, True), (6, False), (10, False), (11, True)])
def test_a_start_with_an_exception_that_does_not_exclude_its_execution_is_followed_by_a_stop(
    code: int, stops: bool
) -> None:
    """Acknowledge (5) says that the request is executed; a gateway (11) has only lost the reply."""
    script = Script("rejected", reply=modbus.ExceptionReply(1, 6, code))
    play(script, lambda: run_command("vc660"))
    assert script.has_acted and script.has_stopped is stops


@pytest.mark.parametrize(("place", "stops"), [("before", False), ("unsent", False), ("sent", True), ("after", True)])
def test_a_run_of_a_drive_that_turns_is_followed_by_a_stop_only_where_its_frequency_may_have_left(
    place: str, stops: bool
) -> None:
    """The frame of a VC660 does not start the motor; the run that it changes is this command's from then on."""

    async def change_frequency() -> ExitCode:
        async with connect.open_drive(target_of("vc660")) as (_, drive):
            await drive.run(10.0)
        script.effects, script.is_due = [], True
        return await run_command("vc660")

    for kind in CLASSES:
        script = Script(place, kind(KEY), acting=Effect.SETTING)
        script.is_due = False
        play(script, change_frequency)
        assert (script.has_acted, script.has_stopped) == (stops, stops), kind
        clear_simulated_buses()


async def calibrate_step(model: str) -> Any:
    """Run the step of a calibration that moves the motor, as ``drivebus calibrate`` does after the key y."""
    target = target_of(model)
    options = {"query_coding": "hex-0.1"} if model == "dzb100" else {}
    async with connect.open_drive(target) as (bus, drive):
        for name, value in options.items():
            drive.dialect.set_option(name, value)
        keys: Any = None
        session = calibrate.CalibrationSession(bus, drive, keys, ShutdownSignal())
        return await calibrate._run_motion(session, drive.calibrate(CALIBRATED[model]))


@pytest.mark.parametrize("model", CALIBRATED)
@pytest.mark.parametrize(("place", "stops"), [("before", False), ("unsent", False), ("sent", True), ("after", True)])
def test_a_failed_calibration_run_is_followed_by_a_stop_only_where_its_start_may_have_left(
    capsys: pytest.CaptureFixture[str], model: str, place: str, stops: bool
) -> None:
    """The command says how that stop ended, or the error does."""
    for kind in CLASSES:
        script = Script(place, kind(KEY))
        found = play(script, lambda: calibrate_step(model))
        assert (script.has_acted, script.has_stopped) == (stops, stops), kind
        if isinstance(found, DrivebusError):
            shown = capsys.readouterr().out + str(found)
            assert ("reports stopped" in shown or "acknowledged the stop" in shown) is stops, kind
        clear_simulated_buses()


# --- a drive of a service -------------------------------------------------------------------------------------------


class ScriptedClient:
    """Client of a service that fails one operation, and answers every other."""

    is_local = False

    def __init__(self, failing: str, error: DrivebusError) -> None:
        self.failing, self.error, self.stops = failing, error, 0

    async def call(self, operation: str, params: Json) -> Json:
        with outcome_unknown_on_loss(operation):
            if operation == self.failing:
                raise error_from_json(error_to_json(self.error))
        self.stops += operation == "drive.stop"
        done = outcome_json(Outcome(status=OutcomeStatus.CONFIRMED, key=KEY))
        drive = {"address": 1, "model": "c320", "comm_loss": {"tested": None, "test": None}}
        return {"outcome": done, "lease": {"session": "a"}, "arm_token": "b", "silence_s": 2.0, **drive}

    async def close(self) -> None: ...


def run_remotely(client: ScriptedClient) -> Any:
    """Return the exit code of a run with ``--service``, or its error."""

    @asynccontextmanager
    async def open_drive(target: Target) -> AsyncIterator[Any]:
        yield RemoteBus(), RemoteDrive(client, "fan-1", 1, profiles.load("c320"))

    async def played() -> Any:
        try:
            target = Target(port="service", model="c320", address=1, service="service", drive="fan-1")
            return await run._run(target, SAFE_HZ["c320"], reverse=False, wait=False, detach=False)
        except DrivebusError as error:
            return error

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connect, "open_drive", open_drive)
        return virtual_time.run(played())


@pytest.mark.parametrize("may_be_running", [True, False, None])
def test_a_failed_run_through_a_service_is_followed_by_a_stop_unless_the_service_knows_better(
    may_be_running: bool | None,
) -> None:
    for kind in CLASSES:
        for failing in ("lease.take", "drive.arm", "drive.run"):
            error = kind(KEY)
            error.may_be_running = may_be_running
            client = ScriptedClient(failing, error)
            run_remotely(client)
            known = False if may_be_running is None and isinstance(error, ServiceError) else may_be_running
            is_refused = failing != "drive.run" or known is False
            assert client.stops == (not is_refused), (kind, failing)


@pytest.mark.parametrize("key", sorted(LOST_KEYS))
def test_a_start_whose_answer_is_lost_is_followed_by_a_stop(key: str) -> None:
    client = ScriptedClient("drive.run", ServiceUnavailable(key))
    run_remotely(client)
    assert client.stops == 1


def test_an_arming_whose_answer_is_lost_is_followed_by_no_stop() -> None:
    """The drive may be run by another user."""
    client = ScriptedClient("drive.arm", ServiceUnavailable("plant.gone"))
    assert isinstance(run_remotely(client), OutcomeUnknown) and client.stops == 0


def run_test_remotely(client: ScriptedClient, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the exit code of a communication-loss test, or its error."""

    @asynccontextmanager
    async def open_client(_: str) -> AsyncIterator[Any]:
        yield client

    monkeypatch.setattr("drivebus.cli.remote.client.open_client", open_client)
    try:
        return asyncio.run(comm_loss_test._connect_and_test("service", "fan-1", 5.0, 2.0, yes=True))
    except DrivebusError as error:
        return error


@pytest.mark.parametrize("key", sorted(LOST_KEYS))
def test_a_communication_loss_test_whose_start_is_lost_is_followed_by_a_stop(
    monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    """The command ended, and the motor may have been running until the service missed its user."""
    client = ScriptedClient("comm_loss.test", ServiceUnavailable(key))
    assert isinstance(run_test_remotely(client, monkeypatch), OutcomeUnknown) and client.stops == 1


@pytest.mark.parametrize("failing", ["lease.take", "drive.arm", "comm_loss.test"])
def test_a_communication_loss_test_that_the_service_refuses_is_followed_by_no_stop(
    monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    client = ScriptedClient(failing, ControlNotHeld("plant.no_lease", drive="fan-1"))
    assert isinstance(run_test_remotely(client, monkeypatch), ControlNotHeld) and client.stops == 0


def test_a_communication_loss_test_whose_service_is_lost_meanwhile_is_followed_by_a_stop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended as if nothing had been started, without a word on the motor."""

    async def lost(_: Any) -> Any:
        raise ServiceUnavailable("plant.not_there", socket="plant.sock")

    monkeypatch.setattr(comm_loss_test, "_result", lost)
    client = ScriptedClient("", ServiceUnavailable(KEY))
    assert run_test_remotely(client, monkeypatch) is ExitCode.FAILED and client.stops == 1
    shown = capsys.readouterr()
    assert "plant.sock" in shown.err and i18n.text(KEY, "en") in shown.out


def test_a_drive_that_another_user_has_taken_over_gets_no_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    async def taken_over(*_: object) -> ExitCode:
        raise ControlNotHeld("plant.no_lease", drive="fan-1")

    monkeypatch.setattr(run, "_watch", taken_over)
    client = ScriptedClient("", ServiceUnavailable(KEY))
    assert isinstance(run_remotely(client), ControlNotHeld) and client.stops == 0


def test_a_service_that_does_not_state_whether_the_motor_may_be_running_is_followed_by_a_stop() -> None:
    """It is a service of an older version."""
    found = error_to_json(TargetNotReached(KEY))
    del found["may_be_running"]
    assert must_stop_after(error_from_json(found))
