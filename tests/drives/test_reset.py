"""Fault reset: an edge, sent while a fault is shown; repeated only unanswered, and while the fault is still there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.reset import reset_fault
from drivebus.drives.state import OutcomeWord
from drivebus.errors import GateError
from drivebus.protocols import sifang
from drivekit import PaperC320, PaperModbus, World, dialect_of, talk_of

RESET = sifang.Control(1, sifang.Operation.RESET_FAULT)


def in_fault(**more: Any) -> World:
    return World(dialect_of("c320"), PaperC320(sifang.State.FAULT, fault_code=5, **more))


def clears(paper: PaperC320, request: sifang.Control) -> Any:
    paper.state = sifang.State.STOPPED
    return paper.ok()


def test_a_reset_is_confirmed_by_later_reads_without_the_fault() -> None:
    world = in_fault(obey=clears)
    outcome = world.play(reset_fault(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.CONFIRMED, "drives.reset_confirmed")
    assert world.sent(sifang.Control) == [RESET]


def test_nothing_is_sent_where_there_is_no_fault() -> None:
    world = World(dialect_of("c320"), PaperC320())
    assert world.play(reset_fault(talk_of(world.dialect))).key == "drives.no_fault"
    assert not world.effects()


def test_an_answered_reset_is_sent_once_although_the_fault_remains() -> None:
    world = in_fault()
    outcome = world.play(reset_fault(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.fault_remains")
    assert world.sent(sifang.Control) == [RESET]


def test_an_unanswered_reset_is_sent_again_while_the_fault_is_shown() -> None:
    lost = [1]

    def second(paper: PaperC320, request: sifang.Control) -> Any:
        return None if lost and lost.pop() else clears(paper, request)

    world = in_fault(obey=second)
    assert world.play(reset_fault(talk_of(world.dialect))).word is OutcomeWord.CONFIRMED
    assert world.sent(sifang.Control) == [RESET] * 2


def test_a_repetition_that_is_not_allowed_any_more_does_not_hide_that_the_reset_was_sent() -> None:
    """Ruling 1: GateError promises that nothing was sent."""
    world = in_fault(obey=lambda paper, request: None)

    def seen(ask: Any) -> None:
        if ask.request == RESET:
            world.around = replace(world.around, duplicate=True)

    world.on_ask = seen
    outcome = world.play(reset_fault(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.fault_remains")
    assert world.sent(sifang.Control) == [RESET]


def test_an_unanswered_reset_that_was_done_is_not_repeated() -> None:
    def silently(paper: PaperC320, request: sifang.Control) -> Any:
        paper.state = sifang.State.STOPPED

    world = in_fault(obey=silently)
    assert world.play(reset_fault(talk_of(world.dialect))).word is OutcomeWord.CONFIRMED
    assert world.sent(sifang.Control) == [RESET]


def test_a_drive_that_turns_is_not_reset_although_it_reports_a_fault() -> None:
    paper = PaperModbus(registers={0x3000: 0x000B, 0x3016: 0x0002})
    world = World(dialect_of("vc660"), paper)
    with pytest.raises(GateError) as caught:
        world.play(reset_fault(talk_of(world.dialect)))
    assert caught.value.key == "drives.reset_while_turning"
    assert not paper.written


def test_df800_shows_no_fault_so_its_reset_is_only_acknowledged() -> None:
    paper = PaperModbus()
    world = World(dialect_of("df800"), paper)
    outcome = world.play(reset_fault(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.ACKNOWLEDGED, "drives.reset_acknowledged")
    assert paper.written == [(0x2000, 0x0010)]
