"""Rows of the table: duplicate addresses, foreign masters, broadcasts."""

from __future__ import annotations

from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives import StopReport, stop_bus
from drivebus.errors import NotPermitted
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.station import SimulatedStation
from drivebus.testing.virtual_time import running
from verification.families.campaigns import campaign_of
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_scenario import MatrixScenario
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import status_read_key
from verification.scenario.scenario import SentRequest

# --- foreign stations -------------------------------------------------------------------------------------------------

FOREIGN_QUIET_S = 61.0
FOREIGN_PAUSE_S = (0.9, 1.5)
"""Pause between two foreign frames, in seconds: the sync probe after the first one has ended by then."""


@cell("duplicate_address")
def duplicate_address(run: CellRun) -> None:
    """Check that second replies raise the alarm and block all commands but stops, and colliding replies are invalid."""
    for apart in (True, False):
        scenario = run.scenario(1, 2)
        second = make_station(run.variant.model, 1, dict(run.variant.options))
        second.set_ramps(2.0, 2.0)
        if apart:  # right behind the first one's answer, as a drive of another make or firmware
            second.faults.added_delay_s = scenario.simulated_bus.settings.seconds(
                run.variant.frames.reply + run.rng.uniform(0.5, 1.5)
            )
        with running(scenario.loop):
            scenario.simulated_bus.add(second)
        for _ in range(6):
            scenario.read(1)
            scenario.run(1.0)
        scenario.expect(scenario.bus.health(1).duplicate_address or not apart, "no alarm")
        scenario.expect(
            scenario.unsolicited_count("duplicate") >= 2 or not apart,
            f"counted {scenario.unsolicited_count('duplicate')}",
        )
        scenario.expect(scenario.failure_count(1) >= 6, "counted as good answers")
        _check_only_stops(run, scenario, (scenario.station(1), second))


def _check_only_stops(run: CellRun, scenario: MatrixScenario, two: tuple[SimulatedStation, SimulatedStation]) -> None:
    mark = len(scenario.requests)
    for what in ("run", "set_frequency"):
        user_command = scenario.command_to_end(1, what, run.random_hz())
        scenario.expect(not user_command.succeeded, f"{what} is {user_command.result_word}")
    scenario.expect(
        not scenario.requests_since(mark, RequestEffect.MOTION, RequestEffect.SETTING), "a command was sent"
    )
    scenario.expect(not any(station.motor.starts for station in two), "started")
    for station in two:
        station.keypad_run(run.random_hz())
    scenario.run(1.0)
    stopping = scenario.command(1, "stop")
    scenario.run(5.0)
    scenario.expect(scenario.requests_since(mark, RequestEffect.STOP), "a stop was withheld")
    scenario.expect(not any(station.motor.energised for station in two), "they did not stop")
    scenario.finish(stopping)


@cell("foreign_master")
def foreign_master(run: CellRun) -> None:
    """Check that two foreign requests raise the alarm and block starts, not stops, until a quiet minute has passed."""
    scenario = run.scenario(1, 2)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    _, data = scenario.plain_read(2)
    accepted = scenario.oracle.accepted_count
    for _ in range(2):
        scenario.expect(not scenario.bus.health(1).foreign_master, "called a foreign master too early")
        scenario.send_foreign(data)
        scenario.run(run.rng.uniform(*FOREIGN_PAUSE_S))
    scenario.expect(
        scenario.bus.health(1).foreign_master and scenario.bus.health(2).foreign_master, "no alarm within two frames"
    )
    scenario.expect(
        scenario.unsolicited_count("foreign_request") == 2 and scenario.oracle.accepted_count == accepted,
        "not counted, or accepted",
    )
    mark = len(scenario.requests)
    command = scenario.command_to_end(1, "run", run.random_hz())
    scenario.expect(getattr(command.error, "key", "") == "drives.foreign_master", f"a start is {command.result_word}")
    scenario.expect(
        not scenario.requests_since(mark, RequestEffect.MOTION) and not scenario.station(1).motor.starts, "started"
    )
    scenario.station(1).keypad_run(run.random_hz())
    scenario.run(1.0)
    stop = scenario.command_to_end(1, "stop")
    scenario.expect(
        stop.result_word == ("confirmed" if run.variant.reports_running else "acknowledged"),
        f"the stop is {stop.result_word}",
    )
    scenario.run(FOREIGN_QUIET_S)
    command = scenario.command_to_end(1, "run", run.random_hz())
    scenario.expect(
        command.result_word == ("confirmed" if run.variant.reports_running else "acknowledged"),
        f"after a minute: {command.result_word}",
    )


# --- broadcasts -------------------------------------------------------------------------------------------------------


@cell("broadcast_other")
def only_stops_are_broadcast(run: CellRun) -> None:
    """Check that no broadcast other than a stop is sent, in any priority and through any station."""
    scenario = run.scenario(1, 2)
    mark = len(scenario.requests)
    for wanted in campaign_of(run.variant.model).matrix.forbidden_broadcasts(run.variant):
        for station in (1, run.variant.broadcast or 0):
            answer = scenario.loop.run_until_complete(
                scenario.bus.transact(
                    BusRequest(station=station, request=wanted, priority=run.rng.choice(list(RequestPriority)))
                )
            )
            scenario.expect(isinstance(answer.error, NotPermitted) and not answer.sent, f"{wanted}: {answer.error!r}")
    scenario.run(1.0)
    scenario.expect(not scenario.requests_since(mark), "something was sent")
    scenario.expect(not any(scenario.station(a).motor.starts for a in (1, 2)), "started")


@cell("broadcast_stop")
def broadcast_stop(run: CellRun) -> None:
    """Check that a bus stop is broadcast where the family can, and then sent to each drive until it confirms."""
    scenario = run.scenario(1, 2, 3)
    for address in (1, 2):
        scenario.start_at(address, run.random_hz())
    scenario.station(3).keypad_run(run.random_hz())
    scenario.run(1.0)
    mark = len(scenario.requests)
    report = _stop_all(scenario)
    scenario.run(4.0)
    sent = scenario.requests_since(mark)
    broadcasts = [request for request in sent if request.address == run.variant.broadcast]
    if not run.variant.stops_by_broadcast:
        scenario.expect(not broadcasts, "an undocumented broadcast")
    else:
        _check_all_stopped(scenario, broadcasts, sent)
    for address in (1, 2, 3):
        scenario.expect(
            any(o.effect is RequestEffect.STOP and o.address == address for o in sent),
            f"{address} got no stop of its own",
        )
        read_back = any(o.address == address and status_read_key(scenario.variant, o.data) for o in sent)
        scenario.expect(read_back or not run.variant.reports_running, f"{address} was not read")
        scenario.expect(not scenario.station(address).motor.energised, f"{address} runs")
    words = {outcome.status.value for _, outcome in report.outcomes}
    scenario.expect(words == {"confirmed" if run.variant.reports_running else "acknowledged"}, f"ended as {words}")
    scenario.expect(report.confirmed is run.variant.reports_running, "confirmed without evidence")
    _check_deaf_drive_named(run)


def _check_all_stopped(scenario: MatrixScenario, broadcasts: list[SentRequest], sent: list[SentRequest]) -> None:
    scenario.expect(
        sent[0] in broadcasts and sent[0].effect is RequestEffect.STOP, "the broadcast is not the first frame"
    )
    scenario.expect(
        all(broadcast.effect in (RequestEffect.STOP, RequestEffect.RELEASE) for broadcast in broadcasts),
        "a broadcast that is no stop",
    )
    if scenario.variant.model == "dzb100":
        scenario.expect(
            all(broadcast.data[2:5] == b"\x0200" for broadcast in broadcasts), "A is not 02, or the address not 00"
        )


def _stop_all(scenario: MatrixScenario) -> StopReport:
    """Run a bus stop as one stop command for each drive."""
    commands = [scenario.oracle.on_command(address, "stop", ("all drives",)) for address in scenario.drives]

    async def stop() -> StopReport:
        report = await stop_bus(scenario.bus, list(scenario.drives.values()))
        scenario.bus.release_start()
        return report

    report: StopReport = scenario.loop.run_until_complete(stop())
    with running(scenario.loop):
        for command, (_, outcome) in zip(commands, report.outcomes, strict=True):
            command.outcome = outcome
            scenario.oracle.on_command_ended(command)
    return report


def _check_deaf_drive_named(run: CellRun) -> None:
    """Check that a drive that does not confirm the stop is reported."""
    scenario = run.scenario(1, 2)
    scenario.start_at(1, run.random_hz())
    scenario.station(1).faults.silent = True
    report = _stop_all(scenario)
    scenario.expect(1 in report.unconfirmed and not report.confirmed, f"{report.outcomes}")
    scenario.expect(scenario.drives[1].stop_pending, "not repeated")
