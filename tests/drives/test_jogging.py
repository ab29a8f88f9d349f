"""Jog: begun once, stopped at once where nobody knows whether it turns (T13)."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives.jogging import LONGEST_LEASE_S, begin, check_lease, end
from drivebus.drives.state import Direction, OutcomeWord
from drivebus.errors import CapabilityError, GateError, LimitError
from drivebus.message import Effect
from drivebus.protocols import sifang
from drivekit import MODELS, PaperC320, PaperModbus, World, dialect_of, talk_of

FORWARD = Direction.FORWARD


def operations(world: World) -> list[sifang.Operation]:
    return [request.operation for request in world.sent(sifang.Control)]


def test_a_jog_is_one_frame_that_carries_its_frequency() -> None:
    world = World(dialect_of("c320"), PaperC320())
    outcome = world.play(begin(talk_of(world.dialect), 5.0, Direction.REVERSE))
    assert (outcome.word, outcome.key) == (OutcomeWord.ACKNOWLEDGED, "drives.jog_begun")
    assert world.sent(sifang.Control) == [sifang.Control(1, sifang.Operation.JOG_REVERSE_AT, 500)]


def test_an_unanswered_jog_is_never_repeated_but_stopped_at_once() -> None:
    def lost(paper: PaperC320, request: sifang.Control) -> Any:
        if request.operation is sifang.Operation.JOG_FORWARD_AT:
            paper.state = sifang.State.JOGGING_FORWARD
            return None
        paper.state = sifang.State.STOPPED
        return paper.ok()

    world = World(dialect_of("c320"), PaperC320(obey=lost))
    outcome = world.play(begin(talk_of(world.dialect), 5.0, FORWARD))
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.jog_unknown")
    first, second, *_ = operations(world)
    assert (first, second) == (sifang.Operation.JOG_FORWARD_AT, sifang.Operation.JOG_STOP)
    assert operations(world).count(sifang.Operation.JOG_FORWARD_AT) == 1


def test_the_end_of_a_jog_is_its_own_stop_and_then_an_ordinary_one_until_it_stands() -> None:
    def only_plain(paper: PaperC320, request: sifang.Control) -> Any:
        if request.operation is sifang.Operation.STOP:
            paper.state = sifang.State.STOPPED
        return paper.ok()

    world = World(dialect_of("c320"), PaperC320(sifang.State.JOGGING_FORWARD, obey=only_plain))
    outcome = world.play(end(talk_of(world.dialect)))
    assert outcome.word is OutcomeWord.CONFIRMED
    assert operations(world)[:2] == [sifang.Operation.JOG_STOP, sifang.Operation.STOP]
    assert set(world.effects()) == {Effect.STOP}


def test_a_jog_begins_at_standstill() -> None:
    world = World(dialect_of("c320"), PaperC320(sifang.State.RUNNING_FORWARD))
    with pytest.raises(GateError):
        world.play(begin(talk_of(world.dialect), 5.0, FORWARD))
    assert not world.effects()


def test_a_refused_jog_is_not_stopped_because_it_never_began() -> None:
    def no(paper: PaperC320, request: sifang.Control) -> Any:
        return sifang.Reply(1, sifang.Response.OUT_OF_RANGE, sifang.State.STOPPED, 0, None, None)

    world = World(dialect_of("c320"), PaperC320(obey=no))
    outcome = world.play(begin(talk_of(world.dialect), 5.0, FORWARD))
    assert outcome.word is OutcomeWord.REFUSED
    assert operations(world) == [sifang.Operation.JOG_FORWARD_AT]


def test_a_jog_of_df800_waits_for_its_proof() -> None:
    paper = PaperModbus(registers={101: 5, 102: 2})
    world = World(dialect_of("df800"), paper)
    with pytest.raises(GateError) as caught:
        world.play(begin(talk_of(world.dialect), None, FORWARD))
    assert caught.value.key == "drives.direction_unproved"
    assert not paper.written


def test_a_jog_above_the_limit_or_without_a_frequency_where_it_needs_one_is_refused() -> None:
    world = World(dialect_of("c320"), PaperC320())
    with pytest.raises(LimitError):
        world.play(begin(talk_of(world.dialect), 51.0, FORWARD))
    dzb = World(dialect_of("dzb100"), PaperC320())
    with pytest.raises(CapabilityError):
        dzb.play(begin(talk_of(dzb.dialect), None, FORWARD))
    assert not world.asks and not dzb.asks


@pytest.mark.parametrize("lease_s", [0.0, -1.0, LONGEST_LEASE_S + 0.001, float("nan"), float("inf")])
def test_a_lease_is_above_zero_and_at_most_half_a_second(lease_s: float) -> None:
    with pytest.raises(LimitError):
        check_lease(lease_s)


@pytest.mark.parametrize("model", [*MODELS, "c300", "e300", "e500", "e550"])
def test_a_model_says_what_decides_its_jog_frequency_as_its_frames_have_it(model: str) -> None:
    """Nobody is offered a frequency that is refused afterwards."""
    dialect = dialect_of(model, **({"direction_proved": True} if model == "df800" else {}))

    def takes(word: int | None) -> bool:
        with suppress(CapabilityError):
            return bool(dialect.jog(FORWARD, word))
        return False

    takes_one, takes_none = takes(5), takes(None)
    says = {(True, True): "either", (True, False): "asked", (False, True): "drive"}[takes_one, takes_none]
    assert profiles.load(model).jog_frequency == says
