"""The actor of a request on the socket of the service; priority and garbage collection of its processes."""

from __future__ import annotations

import gc
import os
import weakref

import pytest

from drivebus.service.auth.actor import Actor, local_actor
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role
from drivebus.service.process.tuning import NICE_BATCH, NICE_GATEWAY, relax_gc, set_nice

ANN_JSON = {"name": "ann", "rights": ["stop", "view"], "session": "s-1", "remote": True, "address": "10.0.0.9"}


def test_an_actor_survives_its_json_form() -> None:
    ann = Actor("ann", frozenset({Right.VIEW, Right.STOP}), "s-1", address="10.0.0.9")
    assert ann.remote, "two steps to a start, by default"
    assert ann.as_json() == ANN_JSON and Actor.from_json(ANN_JSON) == ann
    assert ann.may(Right.STOP) and not ann.may(Right.OPERATE)


@pytest.mark.parametrize("name", ANN_JSON)
def test_an_actor_without_a_field_is_rejected(name: str) -> None:
    with pytest.raises(KeyError):
        Actor.from_json({key: value for key, value in ANN_JSON.items() if key != name})
    with pytest.raises(ValueError):
        Actor.from_json(ANN_JSON | {"rights": ["everything"]})


def test_a_local_actor_has_all_rights_and_starts_in_one_step() -> None:
    me = local_actor("ann", "local-1")
    assert (me.name, me.session, me.remote, me.address) == ("ann", "local-1", False, "local")
    assert me.rights == ROLE_RIGHTS[Role.ADMINISTRATOR] == frozenset(Right)


def test_web_and_batch_work_leave_the_processor_to_the_buses(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []
    monkeypatch.setattr(os, "nice", steps.append)
    set_nice(NICE_GATEWAY), set_nice(NICE_BATCH)
    assert steps == [5, 10]
    monkeypatch.delattr(os, "nice")
    set_nice(NICE_GATEWAY)


def test_a_system_that_refuses_it_goes_on_without(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "nice", refused)
    set_nice(NICE_GATEWAY)


class Thing:
    """Has circles."""

    itself: Thing


def test_what_there_is_is_not_looked_through_again_and_the_rest_seldom() -> None:
    before, thrown_away = gc.get_threshold(), Thing()
    thrown_away.itself, gone = thrown_away, weakref.ref(thrown_away)
    del thrown_away
    try:
        relax_gc()
        assert gone() is None, "or it would stay for ever"
        assert gc.get_threshold() == (before[0], before[1], 100 * before[2])
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)
