"""Rows of the table: truncated answers, bytes too many, garbage before an answer, single flipped bits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.bus import Kind as Became
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.digits import WAITS_S, single_reads_decide_nothing
from drivebus.lab.cells.line import Act, Line, Say
from drivebus.lab.cells.void import lasting, void
from drivebus.message import StationTiming
from drivebus.protocols import modbus, sifang

FLIPS = 6


@case("truncated")
def truncated_answer(at: Case) -> None:
    """Void at the deadline, not before. A whole short error form is no truncated answer."""
    line = at.line()
    cut = at.rng.randrange(1, len(line.said[0].data) - 1)
    void(line, lambda say, data, when: say(data[:-cut], when), "NoReply")
    voided = next(event for event in line.events if event.kind is Became.VOID)
    asked = next(one for one in line.sent[2:] if one.address == 1)
    patience_s = at.kind.patience_s + at.kind.patience_characters * line.bench.line.character_s
    line.expect(voided.time - asked.end >= patience_s, f"void {voided.time - asked.end:.4f} s after the request")
    lasting(line, lambda say, data, when: say(data[:-cut], when))
    if at.kind.model != "dzb100":
        _short_form(at)


def _short_form(at: Case) -> None:
    """C320 codes 6-8 in 11 bytes, Modbus errors in 5 bytes or 11 characters: an answer, whole, asked for once."""
    line = at.line()
    codec = line.drives[1].dialect.codec
    if at.kind.model == "c320":
        reply: Any = sifang.Reply(1, sifang.Response(at.rng.choice((6, 7, 8))))
    else:
        reply = modbus.ErrorReply(1, 3, at.rng.choice((1, 2, 3, 4)) if at.kind.model == "vc660" else None)
    data = codec.encode_reply(reply)
    line.expect(len(data) == (5 if at.kind.encoding == "rtu" else 11), f"{len(data)} bytes")
    line.trick(1, lambda say, _, when: say(data, when), 1)
    failed = line.failures(1)
    answer = line.read(1)
    line.expect(answer.error is None and answer.attempts == 1 and answer.received == data, f"{answer}")
    line.expect(line.failures(1) == failed, "an error form is no failure of the line")


@case("trailing")
def trailing_bytes(at: Case) -> None:
    """Void and counted; from the third on the line is too bad for a start (RELIABILITY 4), and health says why."""
    line = at.line()
    extra = at.rng.randbytes(at.rng.randrange(1, 5))

    def longer(say: Say, data: bytes, when: float) -> Any:
        return say(data + extra, when)

    for _ in range(3):
        void(line, longer, "TrailingError")
    health = line.bus.health(1)
    line.expect(health.error_rate > 0.0 and line.figures(1).damaged >= 3, "health does not show it")
    wish = line.do(1, "run", 5.0)
    line.expect(
        wish.word == "GateError" and getattr(wish.error, "key", "") == "drives.bad_link", f"a start is {wish.word}"
    )
    line.expect(not line.station(1).motor.starts, "started")
    lasting(at.line(), longer)


@case("garbage")
def leading_garbage(at: Case) -> None:
    """Void, and the next try counts: nothing is searched for in a stream. Ruling 10 names what may be switched on."""
    line = at.line()
    for size in range(1, 5):
        junk = at.rng.randbytes(size)
        mark = len(line.sent)
        wanted, data = line.plain(1)
        line.trick(1, behind(junk), 1)
        answer = line.ask(1, wanted)
        line.expect(answer.error is None and answer.attempts == 2, f"{size} bytes of junk: {answer}")
        line.expect([one.data for one in line.since(mark)].count(data) == 2, "not asked twice")
    _tolerant(at)


def behind(junk: bytes) -> Act:
    """The answer after these bytes."""
    return lambda say, data, when: say(junk + data, when)


def _tolerant(at: Case) -> None:
    """Switched on: one junk byte before an answer, in Modbus ASCII up to four before the first ':', and no more."""
    line = at.line()
    drive = line.drives[1]
    timing: StationTiming = replace(drive.dialect.link.timing, leading_junk=True)
    drive.close()
    line.drives[1] = type(drive)(
        line.bus, at.kind.model, 1, encoding=at.kind.encoding, settings=dict(at.kind.settings), timing=timing
    )
    line.read(1)
    most = 4 if at.kind.name == "df800-ascii" else 1
    for size, attempts in ((most, 1), (most + 2, 2)):
        junk = bytes(at.rng.randrange(0x80, 0x100) for _ in range(size))
        line.trick(1, behind(junk), 1)
        answer = line.read(1)
        line.expect(answer.error is None and answer.attempts == attempts, f"{size} bytes of junk: {answer}")


def spoilt(at: Case, marked: bool, where: range | None = None) -> Any:
    """One wrong bit somewhere in the answer, with or without the parity mark that tells it."""

    def act(say: Say, data: bytes, when: float) -> Any:
        index = at.rng.choice(where or range(len(data)))
        said = say(data, when)
        said.spoil(index, data[index] ^ 1 << at.rng.randrange(8), marked)
        return said

    return act


@case("bit_flip")
def single_flipped_bit(at: Case) -> None:
    """Parity, sum, CRC or LRC: void. DZB100 has parity alone: without it two agreeing reads must stand in."""
    line = at.line()
    for number in range(FLIPS):
        marked = at.kind.model in ("c320", "dzb100") and (number % 2 == 0 or at.kind.model == "dzb100")
        _flipped(line, spoilt(at, marked))
    if at.kind.model == "dzb100":
        single_reads_decide_nothing(at)


def _flipped(line: Line, act: Any) -> None:
    """Void; whether it is asked for again at once or behind a fence depends on what the damage leaves of its length."""
    line.run(WAITS_S)
    wanted, data = line.plain(1)
    failed, mark = line.failures(1), len(line.sent)
    line.trick(1, act, 1)
    answer = line.ask(1, wanted)
    line.expect(answer.error is None and answer.attempts == 2, f"a flipped bit was believed: {answer}")
    line.expect(line.failures(1) == failed + 1, f"not counted: {line.figures(1).errors}")
    line.expect([one.data for one in line.since(mark)].count(data) == 2, "not asked twice")
