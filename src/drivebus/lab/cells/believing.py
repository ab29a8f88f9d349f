"""Rows of the table: late answers, and answers from another address."""

from __future__ import annotations

from typing import Any

from drivebus.bus import Kind as Became
from drivebus.lab.cells.alphabet import field
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line, Say
from drivebus.lab.cells.void import quarantined, void

LATE_S = {"c320": (0.06, 0.15), "dzb100": (0.2, 0.5), "vc660": (0.08, 0.17), "df800": (0.2, 0.5)}
"""After the deadline, and before the family's longest lateness is over."""
STRANGER = 9
PROBED_S = 8.0
"""DF800's fences are alike: after a spoiled one the next counts only when no older answer can come (5 s)."""


@case("late_same_item")
def late_answer_to_the_same_question(at: Case) -> None:
    """Ruling 3: counted as late, believed for nothing, not even for the same question asked again."""
    line = at.line()
    late_s = at.rng.uniform(*LATE_S[at.kind.model])
    late = line.kinds("late")
    void(line, lambda say, data, when: say(data, when + late_s), "NoReply")
    line.expect(line.kinds("late") == late + 1, "a late answer that nobody counted")
    line.expect(sum(event.kind is Became.LATE for event in line.events) == 1, "a late answer that nobody told")


@case("late_other_item")
def late_answer_meets_another_question(at: Case) -> None:
    """It comes while the fence is waited for: not taken for its answer. Nothing counts until a fence is answered."""
    line, held = at.line(), list[bytes]()
    wanted, _ = line.plain(1)

    def hold(say: Say, data: bytes, when: float) -> Any:
        held.append(data)

    def release(say: Say, data: bytes, when: float) -> Any:
        said = say(held[0], when)
        return say(data, said.end + line.bench.line.seconds(5))

    mark = len(line.sent)
    line.trick(1, hold, 1)
    line.trick(1, release, 1)
    answer = line.ask(1, wanted)
    quarantined(line, mark)
    line.expect(answer.error is not None, f"believed: {answer.received.hex()}")
    line.expect(line.bus.health(1).suspect, "believed again without a fence")
    line.run(PROBED_S)
    line.expect(not line.bus.health(1).suspect, "never asked again")
    fresh = line.ask(1, wanted)
    line.expect(fresh.error is None and fresh.received == line.said[-1].data, f"{fresh}")
    if at.kind.model == "c320":
        _one_key_two_classes(line)


def _one_key_two_classes(line: Line) -> None:
    """T04: monitor d.1 and parameter F0.1 have one key; a fence is between them."""
    line.loop.run(line.drives[1].status(("output_voltage",)))
    mark = len(line.sent)
    line.loop.run(line.drives[1].read(("F0.1",)))
    sent = line.since(mark)
    parameter = next(
        one for one in sent if field(line.kind, one.data, 3, 1) == 2 and field(line.kind, one.data, 6, 1) == 0
    )
    line.expect(line.fences(one for one in sent if one.start < parameter.start), "F0.1 right after d.1")


@case("other_address")
def answer_from_another_address(at: Case) -> None:
    """Dropped, counted, the deadline stays; the true answer behind it counts. Repeated, it is a foreign master's."""
    line = at.line()
    wanted, _ = line.plain(1)
    theirs = next(said.data for said in line.said if said.address == 2)
    foreign = line.kinds("foreign")

    def first_theirs(say: Say, data: bytes, when: float) -> Any:
        character_s = line.bench.line.character_s
        said = say(theirs, line.loop.time() + character_s, line.station(2))
        return say(data, said.end + character_s)

    line.trick(1, first_theirs, 1)
    answer = line.ask(1, wanted)
    line.expect(answer.error is None and answer.attempts == 1, f"the true answer was lost: {answer.error}")
    line.expect(answer.received == line.said[-1].data and line.kinds("foreign") == foreign + 1, "not counted")
    line.run(3.0)
    _misaddressed(line, wanted)


def _misaddressed(line: Line, wanted: Any) -> None:
    """It answers under an address that nobody has: not its answer, and somebody else's conversation."""
    line.station(1).faults.wrong_address = STRANGER
    for _ in range(2):
        before = line.loop.time()
        answer = line.ask(1, wanted)
        line.expect(answer.error is not None, "an answer of another address was believed")
        line.expect(line.loop.time() - before < 2.0, "the deadline moved")
        line.run(1.5)
    line.expect(line.bus.health(1).foreign_master, "no alarm")
    line.station(1).faults.wrong_address = None
    line.run(1.5)
    wish = line.do(2, "run", 5.0)
    line.expect(wish.word == "GateError" and not line.station(2).motor.starts, f"a start is {wish.word}")
