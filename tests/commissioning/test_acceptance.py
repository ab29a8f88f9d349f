"""The checklist for hardware, tried on simulated drives: each step can pass, each can fail, and a report is left."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.commands import acceptance as acceptance_command
from drivebus.cli.connect import Target
from drivebus.cli.main import cli
from drivebus.cli.signals import ShutdownSignal
from drivebus.commissioning.acceptance import (
    ACCEPTANCE_STEPS,
    AcceptanceInterrupted,
    StepFinding,
    StepRequirement,
    StepResult,
    run_step,
)
from drivebus.drives import Drive
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.errors import PortError, StopUnconfirmed
from drivebus.ports import locks, open_port
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus, simulated_bus_of
from drivebus.testing.virtual_time import run
from fixtures.simulator import ForeignMaster

ACCEPTANCE_LINK = "sim://vc660@1?name=hw&ramp=1"
C320_LINK = "sim://c320@1?name=hw&ramp=1"

pytestmark = pytest.mark.usefixtures("english_output")


class AgreeingPerson(acceptance_command.TerminalAcceptance):
    """Agrees to everything and sees what the simulated motor does."""

    async def ask(self, key: str, /, **params: Any) -> str:
        motor = find_simulated_bus("hw").station(1).motor
        if key in ("acceptance.ask.turns", "acceptance.ask.still_turns"):
            return "y" if motor.energised else "n"
        return "n" if key == "acceptance.ask.stands" and motor.energised else "y"


class RealPort(AgreeingPerson):
    """The simulated line under the name of a real port, whose parity is tested."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.port = "/dev/ttyUSB0"


class PortWithoutParity(RealPort):
    """A port that is opened with another parity and accepts the drive's all the same."""

    def drive(self, serial_format: str | None = None) -> Any:
        return super().drive(None)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Any:
    clear_simulated_buses()
    port: Any = open_port(getattr(request, "param", ACCEPTANCE_LINK))
    yield simulated_bus_of(port)
    clear_simulated_buses()


def step(
    name: str,
    meanwhile: Callable[[], Any] | None = None,
    *,
    motor: bool = True,
    model: str = "vc660",
    session_class: type[acceptance_command.TerminalAcceptance] = AgreeingPerson,
) -> StepFinding:
    async def scenario() -> StepFinding:
        target = Target(port=C320_LINK if model == "c320" else ACCEPTANCE_LINK, model=model, address=1)
        other = asyncio.ensure_future(meanwhile()) if meanwhile is not None else None
        found = await run_step(name, session_class(target, ShutdownSignal(), motor=motor, frequency_hz=5.0))
        if other is not None:
            other.cancel()
        return found

    return run(scenario())


@pytest.mark.parametrize("name", ["port", "quiet", "reply_times", "stray_replies", "run_and_stop"])
def test_on_a_good_line_a_step_passes(bench: SimulatedBus, name: str) -> None:
    found = step(name)
    assert found.verdict is StepResult.PASSED, found
    assert found.figures
    assert found.reason == ""


@pytest.mark.parametrize(
    ("name", "shown_s"), [("port", 0), ("quiet", 3), ("reply_times", 8), ("stray_replies", 8), ("parity", 2)]
)
def test_a_step_that_reads_for_seconds_shows_its_progress_on_a_terminal(
    bench: SimulatedBus, name: str, shown_s: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``acceptance`` printed nothing for half a minute: the user could not see whether it hung."""
    shown: list[tuple[str, float, float]] = []
    monkeypatch.setattr(output.ProgressBar, "update", lambda bar, *progress: shown.append(progress))
    step(name, session_class=RealPort)
    assert {text for text, _, _ in shown} == ({i18n.text(f"acceptance.step.{name}")} if shown_s else set())
    done = [done_s for _, done_s, _ in shown]
    assert done == sorted(done) and all(done_s <= total_s for _, done_s, total_s in shown)
    assert max([total_s for _, _, total_s in shown], default=0) >= shown_s


@pytest.mark.parametrize(
    ("name", "reason"), [("exclusive", "acceptance.not.exclusive"), ("parity", "acceptance.not.parity")]
)
def test_what_a_simulated_line_cannot_show_is_not_called_passed(bench: SimulatedBus, name: str, reason: str) -> None:
    assert (step(name).verdict, step(name).reason) == (StepResult.SKIPPED, reason)


@pytest.mark.parametrize(("language", "simulated"), [("en", "simulated"), ("zh", "模拟")])
def test_the_port_of_a_simulated_line_is_not_called_one_without_a_parity_check(
    bench: SimulatedBus, language: str, simulated: str
) -> None:
    """The step before it lists the parity check among the capabilities of the port."""
    assert step("port").figures["parity"] is True
    assert simulated in i18n.text(step("parity").reason, language)


def test_replies_that_are_accepted_with_the_wrong_parity_are_reported(bench: SimulatedBus) -> None:
    found = step("parity", session_class=RealPort)
    assert (found.verdict, found.reason, found.figures["accepted"]) == (StepResult.PASSED, "", 0)
    found = step("parity", session_class=PortWithoutParity)
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.parity")


@pytest.mark.parametrize(
    ("typed", "is_yes"), [("y", True), ("ｙ　", True), ("Yes", True), ("是", True), ("n", False), ("", False)]
)
def test_a_person_agrees_in_full_width_and_in_words_too(
    monkeypatch: pytest.MonkeyPatch, typed: str, is_yes: bool
) -> None:
    """A step was skipped for the y of a Chinese input method, and the whole checklist had to be repeated."""

    async def read_line() -> str:
        return f"{typed}\n"

    async def confirmed() -> bool:
        session = acceptance_command.TerminalAcceptance(
            Target(port="sim://vc660@1", model="vc660", address=1), ShutdownSignal(), motor=False, frequency_hz=5.0
        )
        return await session.confirm("acceptance.ask.unplug")

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(acceptance_command, "_read_line", read_line)
    assert asyncio.run(confirmed()) is is_yes


def owned(path: str) -> StepFinding:
    return asyncio.run(
        run_step(
            "exclusive",
            acceptance_command.TerminalAcceptance(
                Target(port=path, model="vc660", address=1), ShutdownSignal(), motor=False, frequency_hz=5.0
            ),
        )
    )


@pytest.fixture
def pty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    far, near = os.openpty()
    yield os.ttyname(near)
    os.close(far)
    os.close(near)


def test_another_program_is_rejected_the_port_with_the_owners_pid(pty: str) -> None:
    found = owned(pty)
    assert (found.verdict, found.reason) == (StepResult.PASSED, "")
    assert f"pid {os.getpid()}" in found.figures["refused"]


def test_a_port_that_another_program_gets_is_reported(pty: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "_flock", lambda fd: None)
    monkeypatch.setattr(locks, "_take_lock_file", lambda device: -1)
    found = owned(pty)
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.exclusive")


def test_another_master_is_detected(bench: SimulatedBus) -> None:
    async def speaks() -> None:
        other = ForeignMaster()
        bench.attach(other)
        while True:
            await asyncio.sleep(0.5)
            bench.transmit(other, bytes.fromhex("01 03 30 00 00 01 8B 0A"))

    found = step("quiet", speaks)
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.quiet")


def test_a_noisy_line_fails_the_reads(bench: SimulatedBus) -> None:
    bench.line_quality = "lossy"
    found = step("reply_times")
    assert found.verdict is StepResult.FAILED
    assert found.reason == "acceptance.bad.reply_times"


def test_late_replies_fail_the_sync_probes(bench: SimulatedBus) -> None:
    bench.line_quality = "late=0.1:0.3"
    found = step("stray_replies")
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.stray_replies")


def test_the_adapter_pulled_and_put_back(bench: SimulatedBus) -> None:
    async def replug() -> None:
        await asyncio.sleep(5.0)
        bench.unplug()
        await asyncio.sleep(3.0)
        bench.replug()

    found = step("unplug", replug)
    assert (found.verdict, found.reason) == (StepResult.PASSED, "")
    assert 2.9 < found.figures["away_s"] < 4.0
    found = step("unplug")
    assert (found.reason, found.figures) == ("acceptance.bad.unplug", {"noticed": False})


def test_an_adapter_that_is_not_found_again_fails(bench: SimulatedBus) -> None:
    async def unplug() -> None:
        await asyncio.sleep(5.0)
        bench.unplug()

    found = step("unplug", unplug)
    assert (found.reason, found.figures) == ("acceptance.bad.unplug", {"noticed": True, "back": False})


def test_the_power_step_passes_only_where_the_drive_was_switched_off_and_on(bench: SimulatedBus) -> None:
    async def power_cycle_drive() -> None:
        await asyncio.sleep(5.0)
        bench.station(1).power_cycle(20.0)

    found = step("power", power_cycle_drive)
    assert (found.verdict, found.reason) == (StepResult.PASSED, "")
    found = step("power")
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.power")


def test_a_motor_that_does_not_do_what_is_commanded_fails(bench: SimulatedBus) -> None:
    class DisagreeingPerson(AgreeingPerson):
        async def ask(self, key: str, /, **params: Any) -> str:
            return "n" if key == "acceptance.ask.turns" else "y"

    found = step("run_and_stop", session_class=DisagreeingPerson)
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.bad.run_and_stop")
    assert not bench.stations[0].motor.energised or bench.stations[0].motor.stopping


def test_the_drive_left_alone_is_stopped_afterwards(bench: SimulatedBus) -> None:
    found = step("comm_loss")
    assert found.figures["stop"] == "confirmed"
    assert found.figures["alone_s"] > 3.0
    assert (found.verdict, found.reason) == (StepResult.SKIPPED, "acceptance.not.comm_loss")  # VC660 reports no action


def leaving_person(question: str) -> type[AgreeingPerson]:
    """Return a person who agrees to everything and presses Ctrl-C at a question."""

    class LeavingPerson(AgreeingPerson):
        async def ask(self, key: str, /, **params: Any) -> str:
            if key == question:
                self._shutdown.request("SIGINT")
                await self.race(asyncio.sleep(60.0))
            return await super().ask(key, **params)

    return LeavingPerson


@pytest.mark.parametrize(
    ("name", "question"), [("run_and_stop", "acceptance.ask.turns"), ("comm_loss", "acceptance.ask.still_turns")]
)
def test_ctrl_c_at_a_question_stops_the_motor_and_says_how(bench: SimulatedBus, name: str, question: str) -> None:
    """In the step of the communication loss it left the motor running: the drive had been left alone on purpose."""

    async def scenario() -> None:
        target = Target(port=ACCEPTANCE_LINK, model="vc660", address=1)
        session = leaving_person(question)(target, ShutdownSignal(), motor=True, frequency_hz=5.0)
        with pytest.raises(AcceptanceInterrupted) as caught:
            await run_step(name, session)
        assert caught.value.stop is not None and caught.value.stop.status is OutcomeStatus.CONFIRMED
        assert not bench.station(1).motor.energised

    run(scenario())


def test_a_motor_left_alone_whose_stop_cannot_be_sent_is_an_unconfirmed_stop(bench: SimulatedBus) -> None:
    """It was only a port that can't be opened, with the exit code of a failed step, while the motor ran on."""

    class UnpluggingPerson(AgreeingPerson):
        async def ask(self, key: str, /, **params: Any) -> str:
            if key == "acceptance.ask.still_turns":
                bench.unplug()
            return await super().ask(key, **params)

    found = step("comm_loss", session_class=UnpluggingPerson)
    assert isinstance(found.figures["error"], StopUnconfirmed)
    assert found.figures["error"].key == "drives.stop_not_sent_port"


@pytest.mark.parametrize("name", ["port", "stray_replies", "parity", "run_and_stop", "comm_loss"])
def test_a_step_whose_port_cannot_be_opened_does_not_pass_and_names_no_finding_that_it_did_not_make(
    bench: SimulatedBus, name: str
) -> None:
    """A missing port was reported as replies with a wrong parity; an unplugged simulated one was plugged in again."""
    bench.unplug()
    found = step(name)
    assert (found.verdict, found.reason) == (StepResult.FAILED, "acceptance.not_completed")
    assert isinstance(found.figures["error"], PortError)


def test_the_refusal_of_the_second_program_is_in_the_language_of_the_first(
    pty: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(acceptance_command.output, "language", lambda: "zh")
    assert "被另一个 drivebus" in owned(pty).figures["refused"]


@pytest.mark.parametrize(
    ("question", "folder"), [("acceptance.ask.turns", ""), ("nothing", ""), ("nothing", "that-was-removed")]
)
def test_an_acceptance_whose_stop_is_not_confirmed_ends_with_4_and_says_so(
    bench: SimulatedBus, question: str, folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """After Ctrl-C the command reported "interrupted", and nothing of the stop.

    A report that can't be written ended it with 2.
    """

    async def stop(drive: Drive) -> Outcome:
        raise StopUnconfirmed("drives.stop_no_reply", address=1)

    monkeypatch.setattr(Drive, "stop", stop)
    monkeypatch.setattr(acceptance_command, "TerminalAcceptance", leaving_person(question))
    monkeypatch.setattr(acceptance_command, "ACCEPTANCE_STEPS", ("run_and_stop", "port"))
    target = Target(port=ACCEPTANCE_LINK, model="vc660", address=1)
    assert run(acceptance_command._run(target, motor=True, frequency_hz=5.0, folder=tmp_path / folder)) == 4
    shown = capsys.readouterr()
    assert ("STOP NOT CONFIRMED" in shown.out, folder in shown.err) == (True, True)


def test_the_second_instance_is_not_suspended_by_ctrl_z(monkeypatch: pytest.MonkeyPatch) -> None:
    """The checklist, which ends by Ctrl-Z where it may turn a motor, waited for it for ever."""
    program = [sys.executable, "-c", "import os; print('true' if os.getpgrp() == os.getpid() else 'false')"]
    monkeypatch.setattr(acceptance_command, "module_command", lambda *words: program)
    session = AgreeingPerson(
        Target(port=ACCEPTANCE_LINK, model="vc660", address=1), ShutdownSignal(), motor=True, frequency_hz=5.0
    )
    assert asyncio.run(session.second_instance()) is True


@pytest.mark.parametrize("bench", [C320_LINK], indirect=True)
def test_a_drive_whose_motor_stops_although_its_parameters_let_it_run_on_fails(bench: SimulatedBus) -> None:
    async def trip_in_the_silence() -> None:
        while not bench.station(1).motor.energised:  # noqa: ASYNC110  the motor reports no start
            await asyncio.sleep(0.1)
        await asyncio.sleep(2.0)
        bench.station(1).trip(Trip.OVERHEAT)

    found = step("comm_loss", model="c320")
    assert (found.verdict, found.reason, found.figures["announces_trip"]) == (StepResult.PASSED, "", False)
    found = step("comm_loss", trip_in_the_silence, model="c320")
    assert (found.verdict, found.reason, found.figures["still_turned"]) == (
        StepResult.FAILED,
        "acceptance.bad.comm_loss",
        False,
    )


def test_nothing_moves_without_consent_and_no_step_needs_a_person_who_is_absent(bench: SimulatedBus) -> None:
    class AbsentPerson(acceptance_command.TerminalAcceptance):
        async def ask(self, key: str, /, **params: Any) -> str:
            return ""

    for name, (needs, _) in ACCEPTANCE_STEPS.items():
        if needs is StepRequirement.MOTOR:
            assert step(name, motor=False).reason == "acceptance.no_motor"
        if needs is not StepRequirement.NOTHING:
            assert step(name, session_class=AbsentPerson).verdict is StepResult.SKIPPED
    assert not bench.stations[0].motor.energised


def test_the_counts_of_a_finding_are_a_list_in_the_language_of_the_user() -> None:
    """They were printed as a dict of Python, and later with the names of its classes: ``NoReply 1``."""
    found = StepFinding("soak", StepResult.PASSED, {"reads": 5, "errors": {"late": 2, "NoReply": 1}})
    output.parse_global_options(["--lang", "zh"])
    try:
        assert "reads=5、errors=迟到 2、无应答 1" in acceptance_command._finding_lines(found)
    finally:
        output.parse_global_options(["--lang", "en"])
    assert "reads=5, errors=late 2, no reply 1" in acceptance_command._finding_lines(found)


def test_a_finding_fits_the_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Its figures and its reason ran over the edge, where the terminal broke them within a word."""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("drivebus.cli.output.terminal_width", lambda _: 40)
    found = StepFinding("reply_times", StepResult.FAILED, {"reads": 310, "damaged": 0}, "acceptance.bad.reply_times")
    acceptance_command._print_finding(found)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 4 and max(map(len, lines)) <= 40, lines


def test_an_error_of_the_bus_is_a_finding_not_an_end(bench: SimulatedBus) -> None:
    bench.unplug()
    found = step("reply_times")
    assert found.verdict is StepResult.FAILED
    assert acceptance_command._finding_json(found)["figures"]["error"]


def test_a_dated_report_is_left(bench: SimulatedBus, tmp_path: Path) -> None:
    found = [step("port"), step("parity")]
    acceptance_command.write_report(tmp_path, Target(port=ACCEPTANCE_LINK, model="vc660", address=1), found)
    [written] = tmp_path.glob("drivebus-acceptance-*.json")
    document = json.loads(written.read_text(encoding="utf-8"))
    assert [finding["verdict"] for finding in document["findings"]] == ["passed", "skipped"]
    assert document["model"] == "vc660"
    assert written.with_suffix(".md").exists()


def test_a_report_that_can_t_be_written_is_named_before_the_checklist_and_ends_with_2_after_it(
    bench: SimulatedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was named after the last step only."""
    (tmp_path / "file").touch()
    drive = (ACCEPTANCE_LINK, "--model", "vc660", "--address", "1", "--folder", str(tmp_path / "file" / "reports"))
    result = CliRunner().invoke(cli, ["acceptance", *drive, "--lang", "en"])
    assert (result.exit_code, result.stdout) == (2, "") and "Not a directory" in result.stderr
    monkeypatch.setattr(acceptance_command, "TerminalAcceptance", AgreeingPerson)
    monkeypatch.setattr(acceptance_command, "ACCEPTANCE_STEPS", ("parity",))
    target = Target(port=ACCEPTANCE_LINK, model="vc660", address=1)
    assert run(acceptance_command._run(target, motor=False, frequency_hz=5.0, folder=tmp_path / "gone")) == 2


def test_an_acceptance_whose_output_is_lost_ends_with_the_code_of_its_findings(
    bench: SimulatedBus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended with 2 after its first step; the report has the findings."""

    def fail(text: str, err: bool = False, **_: Any) -> None:
        if not err:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.cli.output.click.echo", fail)
    monkeypatch.setattr(acceptance_command, "TerminalAcceptance", AgreeingPerson)
    monkeypatch.setattr(acceptance_command, "ACCEPTANCE_STEPS", ("parity", "reply_times"))
    target = Target(port=ACCEPTANCE_LINK, model="vc660", address=1)
    code = run(acceptance_command._run(target, motor=False, frequency_hz=5.0, folder=tmp_path))
    [written] = tmp_path.glob("drivebus-acceptance-*.json")
    assert [finding["step"] for finding in json.loads(written.read_text())["findings"]] == ["parity", "reply_times"]
    assert code == 0
