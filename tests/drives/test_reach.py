"""Waiting for the set frequency: what the drive reports counts, and its ramp sets the patience (RELIABILITY 4)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.operation import Talk
from drivebus.drives.reach import deadline_s, reach, tolerance_hz
from drivebus.drives.state import Outcome, OutcomeWord
from drivebus.errors import NotReached, Superseded
from drivebus.protocols import sifang
from drivekit import PaperC320, World, dialect_of, talk_of

STARTED = Outcome(OutcomeWord.CONFIRMED, "drives.start_confirmed")


def waiting(paper: PaperC320) -> tuple[World, Talk]:
    world = World(dialect_of("c320"), paper)
    return world, talk_of(world.dialect)


def wait_for(world: World, talk: Talk, hz: float = 10.0, timeout_s: float | None = 2.0) -> Outcome:
    return world.play(reach(talk, hz, STARTED, timeout_s))


def test_it_is_there_when_the_drive_says_running_at_that_frequency() -> None:
    world, talk = waiting(PaperC320(sifang.State.RUNNING_FORWARD, output=1000))
    outcome = wait_for(world, talk)
    assert (outcome.word, outcome.params["output_hz"]) == (OutcomeWord.CONFIRMED, 10.0)


def test_it_is_not_there_while_the_drive_says_accelerating() -> None:
    world, talk = waiting(PaperC320(sifang.State.ACCELERATING_FORWARD, output=1000))
    with pytest.raises(NotReached) as caught:
        wait_for(world, talk)
    assert caught.value.params["state"] == "accelerating"


@pytest.mark.parametrize("output", [990, 1010])
def test_it_is_not_there_at_another_frequency(output: int) -> None:
    world, talk = waiting(PaperC320(sifang.State.RUNNING_FORWARD, output=output))
    with pytest.raises(NotReached) as caught:
        wait_for(world, talk)
    assert caught.value.params["found_hz"] == output / 100


def test_a_drive_that_stops_ends_the_waiting_at_once() -> None:
    world, talk = waiting(PaperC320(sifang.State.STOPPED))
    with pytest.raises(NotReached):
        wait_for(world, talk, timeout_s=60.0)
    assert world.now < 1.0


def test_a_silent_drive_is_not_said_to_have_failed() -> None:
    world, talk = waiting(PaperC320(silent=True))
    with pytest.raises(NotReached) as caught:
        wait_for(world, talk)
    assert caught.value.key == "drives.not_reached_silent"
    assert caught.value.outcome.word is OutcomeWord.UNKNOWN


def test_a_stop_that_comes_meanwhile_ends_the_waiting() -> None:
    world, talk = waiting(PaperC320(sifang.State.ACCELERATING_FORWARD))

    def stop(ask: Any) -> None:
        world.around = replace(world.around, generation=world.around.generation + 1)

    world.on_ask = stop
    with pytest.raises(Superseded):
        wait_for(world, talk)


def test_patience_comes_from_the_ramp_where_it_is_known() -> None:
    assert deadline_s(10.0, None) == 17.0
    assert deadline_s(None, None) == 60.0
    assert deadline_s(10.0, 3.0) == 3.0


def test_near_is_half_a_percent_and_never_less_than_two_steps() -> None:
    talk = talk_of(dialect_of("c320"))
    assert tolerance_hz(talk, 40.0) == pytest.approx(0.2)
    assert tolerance_hz(talk, 1.0) == pytest.approx(0.02)
