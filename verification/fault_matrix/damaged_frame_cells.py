"""Rows of the table: truncated answers, bytes too many, garbage before an answer, single flipped bits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.bus import TraceKind as Became
from drivebus.protocols import modbus, sunfar
from drivebus.serial_settings import StationTiming
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus, ReplyAction, WireSend
from verification.fault_matrix.swapped_digit_cells import DIGITS_OBSERVATION_S, single_reads_decide_nothing
from verification.fault_matrix.void_checks import check_persistent_failure, check_void

FLIPS_PER_CELL = 6


@cell("truncated")
def truncated_answer(at: CellRun) -> None:
    """Void at the deadline, not before. A whole short error form is no truncated answer."""
    line = at.bus()
    cut = at.rng.randrange(1, len(line.replies[0].data) - 1)
    check_void(line, lambda say, data, when: say(data[:-cut], when), "NoReply")
    voided = next(event for event in line.events if event.kind is Became.INVALID)
    asked = next(one for one in line.requests[2:] if one.address == 1)
    patience_s = at.kind.min_timeout_s + at.kind.min_timeout_characters * line.bench.settings.character_s
    line.expect(voided.time - asked.end >= patience_s, f"void {voided.time - asked.end:.4f} s after the request")
    check_persistent_failure(line, lambda say, data, when: say(data[:-cut], when))
    if at.kind.model != "dzb100":
        _check_short_form(at)


def _check_short_form(at: CellRun) -> None:
    """C320 codes 6-8 in 11 bytes, Modbus errors in 5 bytes or 11 characters: an answer, whole, asked for once."""
    line = at.bus()
    codec = line.drives[1].dialect.codec
    if at.kind.model == "c320":
        reply: Any = sunfar.SunfarReply(1, sunfar.SunfarResponse(at.rng.choice((6, 7, 8))))
    else:
        reply = modbus.ExceptionReply(1, 3, at.rng.choice((1, 2, 3, 4)) if at.kind.model == "vc660" else None)
    data = codec.encode_reply(reply)
    line.expect(len(data) == (5 if at.kind.encoding == "rtu" else 11), f"{len(data)} bytes")
    line.manipulate_replies(1, lambda say, _, when: say(data, when), 1)
    failed = line.failure_count(1)
    answer = line.read(1)
    line.expect(answer.error is None and answer.attempts == 1 and answer.received == data, f"{answer}")
    line.expect(line.failure_count(1) == failed, "an error form is no failure of the line")


@cell("trailing")
def trailing_bytes(at: CellRun) -> None:
    """Void and counted; from the third on the line is too bad for a start (RELIABILITY 4), and health says why."""
    line = at.bus()
    extra = at.rng.randbytes(at.rng.randrange(1, 5))

    def longer(say: WireSend, data: bytes, when: float) -> Any:
        return say(data + extra, when)

    for _ in range(3):
        check_void(line, longer, "TrailingError")
    health = line.bus.health(1)
    line.expect(health.error_rate > 0.0 and line.statistics(1).damaged >= 3, "health does not show it")
    command = line.command_to_end(1, "run", 5.0)
    line.expect(
        command.result_word == "StartInhibited" and getattr(command.error, "key", "") == "drives.high_error_rate",
        f"a start is {command.result_word}",
    )
    line.expect(not line.station(1).motor.starts, "started")
    check_persistent_failure(at.bus(), longer)


@cell("garbage")
def leading_garbage(at: CellRun) -> None:
    """Void, and the next try counts: nothing is searched for in a stream. Ruling 10 names what may be switched on."""
    line = at.bus()
    for size in range(1, 5):
        junk = at.rng.randbytes(size)
        mark = len(line.requests)
        wanted, data = line.plain_read(1)
        line.manipulate_replies(1, after_junk(junk), 1)
        answer = line.transact(1, wanted)
        line.expect(answer.error is None and answer.attempts == 2, f"{size} bytes of junk: {answer}")
        line.expect([one.data for one in line.requests_since(mark)].count(data) == 2, "not asked twice")
    _check_tolerated_noise(at)


def after_junk(junk: bytes) -> ReplyAction:
    """The answer after these bytes."""
    return lambda say, data, when: say(junk + data, when)


def _check_tolerated_noise(at: CellRun) -> None:
    """Switched on: one junk byte before an answer, in Modbus ASCII up to four before the first ':', and no more."""
    line = at.bus()
    drive = line.drives[1]
    timing: StationTiming = replace(drive.dialect.station_config.timing, tolerate_leading_noise=True)
    drive.close()
    line.drives[1] = type(drive)(
        line.bus, at.kind.model, 1, encoding=at.kind.encoding, options=dict(at.kind.drive_options), timing=timing
    )
    line.read(1)
    most = 4 if at.kind.name == "df800-ascii" else 1
    for size, attempts in ((most, 1), (most + 2, 2)):
        junk = bytes(at.rng.randrange(0x80, 0x100) for _ in range(size))
        line.manipulate_replies(1, after_junk(junk), 1)
        answer = line.read(1)
        line.expect(answer.error is None and answer.attempts == attempts, f"{size} bytes of junk: {answer}")


def corrupt_reply(at: CellRun, marked: bool, where: range | None = None) -> Any:
    """One wrong bit somewhere in the answer, with or without the parity mark that tells it."""

    def act(say: WireSend, data: bytes, when: float) -> Any:
        index = at.rng.choice(where or range(len(data)))
        text = say(data, when)
        text.corrupt(index, data[index] ^ 1 << at.rng.randrange(8), marked)
        return text

    return act


@cell("bit_flip")
def single_flipped_bit(at: CellRun) -> None:
    """Parity, sum, CRC or LRC: void. DZB100 has parity alone: without it two agreeing reads must stand in."""
    line = at.bus()
    for number in range(FLIPS_PER_CELL):
        marked = at.kind.model in ("c320", "dzb100") and (number % 2 == 0 or at.kind.model == "dzb100")
        _check_flipped(line, corrupt_reply(at, marked))
    if at.kind.model == "dzb100":
        single_reads_decide_nothing(at)


def _check_flipped(line: MatrixBus, act: Any) -> None:
    """Void; whether it is asked for again at once or behind a fence depends on what the damage leaves of its length."""
    line.run(DIGITS_OBSERVATION_S)
    wanted, data = line.plain_read(1)
    failed, mark = line.failure_count(1), len(line.requests)
    line.manipulate_replies(1, act, 1)
    answer = line.transact(1, wanted)
    line.expect(answer.error is None and answer.attempts == 2, f"a flipped bit was believed: {answer}")
    line.expect(line.failure_count(1) == failed + 1, f"not counted: {line.statistics(1).errors}")
    line.expect([one.data for one in line.requests_since(mark)].count(data) == 2, "not asked twice")
