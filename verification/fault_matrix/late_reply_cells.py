"""Rows of the table: late answers, and answers from another address."""

from __future__ import annotations

from typing import Any

from drivebus.bus import TraceKind as Became
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.frame_fields import c320_field
from verification.fault_matrix.matrix_bus import MatrixBus, WireSend
from verification.fault_matrix.void_checks import check_quarantine, check_void

REPLY_LATENESS_S = {"c320": (0.06, 0.15), "dzb100": (0.2, 0.5), "vc660": (0.08, 0.17), "df800": (0.2, 0.5)}
"""After the deadline, and before the family's longest lateness is over."""
UNUSED_ADDRESS = 9
PROBE_INTERVAL_S = 8.0
"""DF800's fences are alike: after a spoiled one the next counts only when no older answer can come (5 s)."""


@cell("late_same_item")
def late_reply_to_the_same_request(at: CellRun) -> None:
    """Counted as late, believed for nothing, not even for the same question asked again."""
    line = at.bus()
    late_s = at.rng.uniform(*REPLY_LATENESS_S[at.kind.model])
    late = line.unsolicited_count("late")
    check_void(line, lambda say, data, when: say(data, when + late_s), "NoReply")
    line.expect(line.unsolicited_count("late") == late + 1, "a late answer that nobody counted")
    line.expect(sum(event.kind is Became.LATE for event in line.events) == 1, "a late answer that nobody told")


@cell("late_other_item")
def late_reply_during_another_request(at: CellRun) -> None:
    """It comes while the fence is waited for: not taken for its answer. Nothing counts until a fence is answered."""
    line, held = at.bus(), list[bytes]()
    wanted, _ = line.plain_read(1)

    def hold(say: WireSend, data: bytes, when: float) -> Any:
        held.append(data)

    def release(say: WireSend, data: bytes, when: float) -> Any:
        text = say(held[0], when)
        return say(data, text.end + line.bench.settings.seconds(5))

    mark = len(line.requests)
    line.manipulate_replies(1, hold, 1)
    line.manipulate_replies(1, release, 1)
    answer = line.transact(1, wanted)
    check_quarantine(line, mark)
    line.expect(answer.error is not None, f"believed: {answer.received.hex()}")
    line.expect(line.bus.health(1).suspect, "believed again without a fence")
    line.run(PROBE_INTERVAL_S)
    line.expect(not line.bus.health(1).suspect, "never asked again")
    fresh = line.transact(1, wanted)
    line.expect(fresh.error is None and fresh.received == line.replies[-1].data, f"{fresh}")
    if at.kind.model == "c320":
        _check_same_key_other_class(line)


def _check_same_key_other_class(line: MatrixBus) -> None:
    """T04: monitor d.1 and parameter F0.1 have one key; a fence is between them."""
    line.loop.run_until_complete(line.drives[1].status(("output_voltage",)))
    mark = len(line.requests)
    line.loop.run_until_complete(line.drives[1].read(("F0.1",)))
    sent = line.requests_since(mark)
    parameter = next(
        one for one in sent if c320_field(line.kind, one.data, 3, 1) == 2 and c320_field(line.kind, one.data, 6, 1) == 0
    )
    line.expect(line.sync_probes(one for one in sent if one.start < parameter.start), "F0.1 right after d.1")


@cell("other_address")
def reply_from_another_address(at: CellRun) -> None:
    """Dropped, counted, the deadline stays; the true answer behind it counts. Repeated, it is a foreign master's."""
    line = at.bus()
    wanted, _ = line.plain_read(1)
    theirs = next(text.data for text in line.replies if text.address == 2)
    foreign = line.unsolicited_count("foreign")

    def first_theirs(say: WireSend, data: bytes, when: float) -> Any:
        character_s = line.bench.settings.character_s
        text = say(theirs, line.loop.time() + character_s, line.station(2))
        return say(data, text.end + character_s)

    line.manipulate_replies(1, first_theirs, 1)
    answer = line.transact(1, wanted)
    line.expect(answer.error is None and answer.attempts == 1, f"the true answer was lost: {answer.error}")
    line.expect(
        answer.received == line.replies[-1].data and line.unsolicited_count("foreign") == foreign + 1, "not counted"
    )
    line.run(3.0)
    _check_misaddressed(line, wanted)


def _check_misaddressed(line: MatrixBus, wanted: Any) -> None:
    """It answers under an address that nobody has: not its answer, and somebody else's conversation."""
    line.station(1).faults.wrong_address = UNUSED_ADDRESS
    for _ in range(2):
        before = line.loop.time()
        answer = line.transact(1, wanted)
        line.expect(answer.error is not None, "an answer of another address was believed")
        line.expect(line.loop.time() - before < 2.0, "the deadline moved")
        line.run(1.5)
    line.expect(line.bus.health(1).foreign_master, "no alarm")
    line.station(1).faults.wrong_address = None
    line.run(1.5)
    command = line.command_to_end(2, "run", 5.0)
    line.expect(
        command.result_word == "StartInhibited" and not line.station(2).motor.starts,
        f"a start is {command.result_word}",
    )
