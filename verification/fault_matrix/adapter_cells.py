"""Rows of the table: faults of the adapter and of the host."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from drivebus.errors import DrivebusError
from verification.families.campaigns import campaign_of
from verification.fault_matrix.cell import CellRun, cell, check_failed_read
from verification.fault_matrix.matrix_scenario import MatrixScenario
from verification.reference.effects import RequestEffect
from verification.scenario.scenario import SentRequest

# --- adapter ----------------------------------------------------------------------------------------------------------


@cell("cut_last_byte")
def transmitter_disabled_too_early(run: CellRun) -> None:
    """Cut off the last byte: without that of the requests all drives are offline; a reply without it is invalid and
    read again."""
    scenario = run.scenario(1, 2, 3)
    scenario.cuts_last_byte = True
    for address in (1, 2, 3):
        scenario.monitored(address)
    scenario.run(6.0)
    for address in (1, 2, 3):
        scenario.expect(
            scenario.failure_count(address, "NoReply") >= 2, f"{address}: {scenario.statistics(address).errors}"
        )
        scenario.expect(str(scenario.bus.health(address).presence) == "offline", f"{address} is called present")
        scenario.expect(scenario.has_bad_quality(address), f"{address} has values")
    command = scenario.command_to_end(1, "run", run.random_hz())
    scenario.expect(not command.succeeded and not scenario.station(1).motor.starts, f"run {command.result_word}")
    own = run.scenario(1, 2)
    check_failed_read(own, lambda transmit, data, when: transmit(data, when).dropped.add(len(data) - 1), "NoReply")
    if not run.variant.has_checksum:
        _check_missing_last_byte(run)


def _check_missing_last_byte(run: CellRun) -> None:
    """Check that a drive without end mark and timeout, which takes the next frame's first byte, never moves."""
    scenario = run.scenario(1)
    station = scenario.station(1)
    station.rule = type(station.rule)(gap_characters=1e6, start_bytes=station.rule.start_bytes)
    scenario.simulated_bus._group_stations()
    scenario.read(1)
    for _ in range(3):
        scenario.cuts_last_byte = True
        scenario.read(1)
        scenario.cuts_last_byte = False
        scenario.run(2.0)
    scenario.run(8.0)
    scenario.expect(not station.motor.starts and not station.memory.eeprom_writes.total(), "cut reads did something")
    scenario.expect(scenario.read(1).error is None, "never in step again")


@cell("batches")
def batched_reception(run: CellRun) -> None:
    """Check that replies with gaps from the adapter are accepted and commands succeed."""
    scenario = run.scenario(1, 2, line_quality="batches")
    for address in (1, 2):
        scenario.monitored(address)
    scenario.run(3.0)
    command = scenario.command_to_end(1, "run", run.random_hz())
    scenario.expect(command.succeeded and scenario.station(1).motor.starts == 1, f"run {command.result_word}")
    stop = scenario.command_to_end(1, "stop")
    scenario.expect(stop.succeeded, f"stop {stop.result_word}")
    scenario.run(3.0)
    for address in (1, 2):
        scenario.expect(not scenario.failure_count(address), f"{address}: {scenario.statistics(address).errors}")
        scenario.expect(scenario.statistics(address).replies > 5, "few answers")
        scenario.expect(not scenario.has_bad_quality(address), "not accepted")


@cell("adapter_lost")
def adapter_unplugged(run: CellRun) -> None:
    """Unplug during a start and before one: the outcome is unknown or an error, and the start is never sent again."""
    for what in (RequestEffect.MOTION, RequestEffect.READ):
        scenario = run.scenario(1, 2)
        scenario.loop.run_until_complete(scenario.drives[1].preflight())
        scenario.monitored(2)
        _unplug_during(run, scenario, what)
        user_command, mark = scenario.command(1, "run", run.random_hz()), len(scenario.requests)
        scenario.run(1.0)
        while scenario.simulated_bus.wire.plugged and not user_command.is_ended:
            scenario.run(0.1)
        scenario.expect(not scenario.simulated_bus.wire.plugged, "nothing was pulled")
        _check_port_lost(scenario)
        scenario.replug()
        scenario.run(8.0)
        scenario.finish(user_command)
        moves = scenario.requests_since(mark, RequestEffect.MOTION)
        scenario.expect(
            not user_command.succeeded or what is RequestEffect.READ,
            f"ended as {user_command.result_word}",
        )
        scenario.expect(len(moves) == (what is RequestEffect.MOTION), f"{len(moves)} starts")
        never_sent = ("PortLost", "PreflightError")
        scenario.expect(
            user_command.result_word == "unknown" if moves else user_command.result_word in never_sent,
            f"ended as {user_command.result_word}, {user_command.error!r}",
        )
        scenario.expect(
            not scenario.requests_since(mark, RequestEffect.SETTING) or not run.variant.start_has_setpoint,
            "a setpoint was sent",
        )
        scenario.expect(scenario.bus.is_open and not scenario.bus.health(2).suspect, "polling does not go on")
        scenario.expect(not scenario.has_bad_quality(2), "no values again")


def _unplug_during(run: CellRun, scenario: MatrixScenario, what: RequestEffect) -> None:
    """Unplug at a random instant of the next frame with this effect."""

    def pull(sent: SentRequest) -> None:
        if sent.address == 1 and sent.effect is what:
            scenario.when_sent = lambda sent: None
            scenario.loop.call_later(run.rng.uniform(0.0, sent.end - sent.start), scenario.unplug)

    scenario.when_sent = pull


def _check_port_lost(scenario: MatrixScenario) -> None:
    scenario.expect(not scenario.bus.is_open, "the port is not reported as lost")
    for address in (1, 2):
        health = scenario.bus.health(address)
        scenario.expect(str(health.presence) == "offline" and health.suspect, f"{address}: {health}")
    scenario.run(3.5)
    scenario.expect(scenario.has_bad_quality(2), "values without a port")


# --- echo -------------------------------------------------------------------------------------------------------------

ABSENT_ADDRESS = 9


@cell("echo")
def adapter_echo(run: CellRun) -> None:
    """Check that an echo is removed where it is configured, and never accepted as a reply where it is not."""
    for setting in ("on", "detect"):
        scenario = run.scenario(1, echo=setting, line_quality="echo")
        answer = scenario.read(1)
        scenario.expect(
            answer.error is None and answer.received == scenario.replies[-1].data, f"echo {setting}: {answer}"
        )
        command = scenario.command_to_end(1, "run", run.random_hz())
        scenario.expect(
            command.result_word == ("confirmed" if run.variant.reports_running else "acknowledged"),
            f"echo {setting}: run {command.result_word}",
        )
        scenario.expect(scenario.station(1).motor.starts == 1, "not one start")
    for setting, line_quality in (("on", "echo"), ("detect", "echo"), ("off", "echo"), ("on", "clean")):
        for paced in (True, False):
            _check_absent_drive(run, setting, line_quality, paced=paced)
    for setting in ("on", "detect", "off"):
        _check_frame_not_received(run, setting)
    _check_unconfigured_echo(run)


def _check_absent_drive(run: CellRun, setting: str, line_quality: str, *, paced: bool) -> None:
    """Check that no echo acknowledges a write to an absent drive, whatever the echo setting.

    Without line timing (TCP) the echo arrives when a reply is expected.
    """
    scenario = run.scenario(1, echo=setting, line_quality=line_quality)
    scenario.bus.core.has_line_timing, scenario.oracle.frame_rules.echo_may_look_damaged = paced, not paced
    family = campaign_of(run.variant.model)
    notation = family.saved_parameters.get(run.variant.model, "")
    saves = notation not in family.matrix.ram_parameters  # T21: a RAM write has an echo of a reply's length in C320
    commands: dict[str, tuple[Any, ...]] = {
        "write": ({notation: 7.0},),
        "set_frequency": (run.random_hz(),),
        "reset_fault": (),
        "run": (run.random_hz(),),
        "stop": (),
    }
    commands = {what: arguments for what, arguments in commands.items() if what not in family.lacks}
    for address, (what, arguments) in enumerate(
        commands.items(), ABSENT_ADDRESS
    ):  # a new address each time: after one failure nothing of a station is accepted
        flags = {"save": saves} if what == "write" else {}
        _check_not_confirmed(scenario, scenario.add_absent(address), what, *arguments, **flags)


def _check_not_confirmed(scenario: MatrixScenario, address: int, what: str, *arguments: Any, **flags: bool) -> None:
    command = scenario.command_to_end(address, what, *arguments, **flags)
    scenario.expect(not command.succeeded, f"{what} is {command.result_word} by an echo")


def _check_frame_not_received(run: CellRun, setting: str) -> None:
    """Check that the echo of a frame that the drive did not receive is not accepted as its reply."""
    scenario = run.scenario(1, echo=setting, line_quality="echo")
    with suppress(DrivebusError):
        scenario.loop.run_until_complete(scenario.drives[1].preflight())
    manipulations = [
        scenario.manipulate_replies(1, "deaf", effect=effect) for effect in (RequestEffect.SETTING, RequestEffect.STOP)
    ]
    _check_not_confirmed(scenario, 1, "set_frequency", run.random_hz())
    scenario.station(1).keypad_run(run.random_hz())
    scenario.run(1.0)
    _check_not_confirmed(scenario, 1, "stop")
    scenario.expect(
        scenario.drives[1].stop_pending and scenario.station(1).motor.energised, "given up, or stopped unheard"
    )
    for manipulation in manipulations:
        manipulation.remaining = 0
    scenario.run(8.0)
    scenario.expect(not scenario.station(1).motor.energised, "it received the stop and runs")


def _check_unconfigured_echo(run: CellRun) -> None:
    """Check that with an unconfigured echo only the drive's own replies are accepted."""
    scenario, hz = run.scenario(1, echo="off", line_quality="echo"), run.random_hz()
    for _ in range(3):
        answer = scenario.read(1)
        scenario.expect(answer.error is not None or answer.received == scenario.replies[-1].data, f"accepted: {answer}")
        scenario.run(1.5)
    command = scenario.command_to_end(1, "set_frequency", hz)
    station = scenario.station(1)
    held = getattr(station, "bus_hz", station.setpoint_hz)
    scenario.expect(
        not command.succeeded or abs(held - hz) < 0.006,
        f"set_frequency {command.result_word}, the drive holds {held}",
    )


# --- host -------------------------------------------------------------------------------------------------------------

COMM_LOSS_TIMEOUT_S = 5.0


@cell("host_restart")
def host_restarted_while_running(run: CellRun) -> None:
    """Check that a restarted host only reads and reports what it finds. The C320 stops by itself without requests."""
    scenario, hz = run.scenario(1, 2), run.random_hz()
    if run.variant.model == "c320":
        scenario.station(1).keypad_set(0x9_04, round(COMM_LOSS_TIMEOUT_S * 10))
    scenario.start_at(1, hz)
    _check_restart(run, scenario, hz)
    if run.variant.model == "c320":
        scenario.restart_host()
        scenario.run(COMM_LOSS_TIMEOUT_S + 4.0)
        scenario.expect(not scenario.station(1).motor.energised, "F9.4 has passed in silence, and it runs")


def _check_restart(run: CellRun, scenario: MatrixScenario, hz: float) -> None:
    mark, at_s = len(scenario.requests), scenario.loop.time()
    scenario.restart_host()
    scenario.run(run.rng.uniform(0.0, 1.0))
    monitors = [scenario.monitored(address) for address in (1, 2)]
    scenario.run(20.0)
    scenario.expect(
        len(scenario.requests_since(mark)) > 20
        and not [o for o in scenario.requests[mark:] if o.effect is not RequestEffect.READ],
        "not only reads",
    )
    scenario.expect(scenario.station(1).motor.energised, "a running drive was stopped")
    scenario.expect(not scenario.station(2).motor.starts, "a stopped drive was started")
    status = monitors[0].status()
    if run.variant.reports_running:
        scenario.expect(
            str(status.state) == "running", f"called {status.state} {scenario.loop.time() - at_s:.1f} s after"
        )
        scenario.expect(abs(float(status.readings["output_frequency"].value) - hz) <= 0.11, f"{status.readings}")
    else:
        scenario.expect(str(status.state) == "unknown", f"called {status.state}")
    stop = scenario.command_to_end(1, "stop")
    scenario.expect(
        stop.result_word == ("confirmed" if run.variant.reports_running else "acknowledged"),
        f"the stop is {stop.result_word}",
    )


@cell("comm_loss")
def communication_loss_reaction(run: CellRun) -> None:
    """Check that the reaction to communication loss is reported as set, and as unknown where no manual gives it."""
    scenario = run.scenario(1)
    report = scenario.loop.run_until_complete(scenario.drives[1].comm_loss_behaviour())
    words = {report.text(language) for language in ("en", "zh")}
    scenario.expect(len(words) == 2 and report.key not in words, f"{report.key} has no words in both languages")
    if run.variant.model != "c320":
        scenario.expect(report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unpublished", f"{report}")
        return
    scenario.expect(report.stops_on_comm_loss is False and report.key == "drives.comm_loss_off", f"F9.4 = 0: {report}")
    scenario.station(1).keypad_set(0x9_04, run.rng.randrange(10, 100))
    report = scenario.loop.run_until_complete(scenario.drives[1].comm_loss_behaviour())
    scenario.expect(
        report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unknown",
        f"F9.3 is not published: {report}",
    )
    scenario.station(1).faults.silent = True
    report = scenario.loop.run_until_complete(scenario.drives[1].comm_loss_behaviour())
    scenario.expect(report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unread", f"unread: {report}")
