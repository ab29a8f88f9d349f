"""Rows of the table: the adapter cuts the last byte, hands bytes over in batches, is pulled out."""

from __future__ import annotations

from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus, MatrixRequest
from verification.fault_matrix.void_checks import check_void
from verification.reference.request_effects import RequestEffect

SUCCESS_WORDS = ("confirmed", "acknowledged")


@cell("cut_last_byte")
def transmitter_disabled_too_early(at: CellRun) -> None:
    """Ours cuts every frame: no drive hears us, all are told silent. A drive's own cuts one: void and asked again."""
    line = at.bus(1, 2, 3)
    line.cuts_last_byte = True
    for address in (1, 2, 3):
        line.monitored(address)
    line.run(6.0)
    for address in (1, 2, 3):
        line.expect(line.failure_count(address, "NoReply") >= 2, f"{address}: {line.statistics(address).errors}")
        line.expect(str(line.bus.health(address).presence) == "offline", f"{address} is called present")
        line.expect(line.has_bad_quality(address), f"{address} has values")
    command = line.command_to_end(1, "run", at.random_hz())
    line.expect(
        command.result_word not in SUCCESS_WORDS and not line.station(1).motor.starts, f"run {command.result_word}"
    )
    own = at.bus(1, 2)
    check_void(own, lambda say, data, when: say(data, when).dropped.add(len(data) - 1), "NoReply")
    if at.kind.model == "dzb100":
        _check_missing_last_byte(at)


def _check_missing_last_byte(at: CellRun) -> None:
    """No end mark: a drive without a timeout takes the next frame's first byte for its last. Nothing may move."""
    line = at.bus(1)
    station = line.station(1)
    station.rule = type(station.rule)(1e6, start_bytes=station.rule.start_bytes)
    line.bench._group_stations()
    line.read(1)
    for _ in range(3):
        line.cuts_last_byte = True
        line.read(1)
        line.cuts_last_byte = False
        line.run(2.0)
    line.run(8.0)
    line.expect(not station.motor.starts and not station.memory.eeprom_writes.total(), "cut reads did something")
    line.expect(line.read(1).error is None, "never in step again")


@cell("batches")
def batched_reception(at: CellRun) -> None:
    """The gap inside an answer is the adapter's: accepted, and commands end as ever."""
    line = at.bus(1, 2, line_quality="batches")
    for address in (1, 2):
        line.monitored(address)
    line.run(3.0)
    command = line.command_to_end(1, "run", at.random_hz())
    line.expect(
        command.result_word in SUCCESS_WORDS and line.station(1).motor.starts == 1, f"run {command.result_word}"
    )
    stop = line.command_to_end(1, "stop")
    line.expect(stop.result_word in SUCCESS_WORDS, f"stop {stop.result_word}")
    line.run(3.0)
    for address in (1, 2):
        line.expect(not line.failure_count(address), f"{address}: {line.statistics(address).errors}")
        line.expect(line.statistics(address).replies > 5, "few answers")
        line.expect(not line.has_bad_quality(address), "not accepted")


@cell("adapter_lost")
def adapter_unplugged(at: CellRun) -> None:
    """While a start is on the wire, and while one is wished: unknown or never sent, told so, and never sent again."""
    for what in (RequestEffect.MOTION, RequestEffect.READ):
        line = at.bus(1, 2)
        line.loop.run_until_complete(line.drives[1].preflight())
        line.monitored(2)
        _unplug_during(at, line, what)
        user_command, mark = line.command(1, "run", at.random_hz()), len(line.requests)
        line.run(1.0)
        line.expect(not line.bench.wire.plugged, "nothing was pulled")
        _check_port_lost(line)
        line.replug()
        line.run(8.0)
        line.finish(user_command)
        moves = line.requests_since(mark, RequestEffect.MOTION)
        line.expect(
            user_command.result_word not in SUCCESS_WORDS or what is RequestEffect.READ,
            f"told {user_command.result_word}",
        )
        line.expect(len(moves) == (what is RequestEffect.MOTION), f"{len(moves)} starts")
        never_sent = ("PortLost", "PreflightError")
        line.expect(
            user_command.result_word == "unknown" if moves else user_command.result_word in never_sent,
            f"told {user_command.result_word}, {user_command.error!r}",
        )
        line.expect(
            not line.requests_since(mark, RequestEffect.SETTING) or at.kind.model in ("vc660", "df800"),
            "a setpoint was sent",
        )
        line.expect(line.bus.is_open and not line.bus.health(2).suspect, "polling does not go on")
        line.expect(not line.has_bad_quality(2), "no values again")


def _unplug_during(at: CellRun, line: MatrixBus, what: RequestEffect) -> None:
    """Somewhere within the next frame that does this."""

    def pull(sent: MatrixRequest) -> None:
        if sent.address == 1 and sent.effect is what:
            line.when_sent = lambda sent: None
            line.loop.call_later(at.rng.uniform(0.0, sent.end - sent.start), line.unplug)

    line.when_sent = pull


def _check_port_lost(line: MatrixBus) -> None:
    line.expect(not line.bus.is_open, "the port is not told lost")
    for address in (1, 2):
        health = line.bus.health(address)
        line.expect(str(health.presence) == "offline" and health.suspect, f"{address}: {health}")
    line.run(3.5)
    line.expect(line.has_bad_quality(2), "values without a port")
