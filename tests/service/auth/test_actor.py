"""Actor of a request and its JSON; process priority and garbage collection."""

from __future__ import annotations

import gc
import os
import weakref

import pytest

from drivebus.service.auth.actor import Actor, local_actor, local_user
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role
from drivebus.service.process.tuning import NICE_BATCH, NICE_GATEWAY, relax_gc, set_nice

ACTOR_JSON = {"name": "ann", "rights": ["stop", "view"], "session": "s-1", "remote": True, "address": "10.0.0.9"}


def test_an_actor_survives_its_json_form() -> None:
    ann = Actor("ann", frozenset({Right.VIEW, Right.STOP}), "s-1", address="10.0.0.9")
    assert ann.remote, "a start takes two steps by default"
    assert ann.as_json() == ACTOR_JSON and Actor.from_json(ACTOR_JSON) == ann
    assert ann.may(Right.STOP) and not ann.may(Right.OPERATE)


def test_a_person_at_the_command_line_is_never_recorded_under_the_name_of_the_service(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.setenv(name, "drivebus")
    monkeypatch.setenv("SUDO_USER", "anna")
    assert local_user() == "anna"
    monkeypatch.delenv("SUDO_USER")
    assert local_user() == "drivebus/command-line"
    monkeypatch.setenv("LOGNAME", "root")
    assert local_user() == "root"


@pytest.mark.parametrize("name", ACTOR_JSON)
def test_an_actor_without_a_field_is_rejected(name: str) -> None:
    with pytest.raises(KeyError):
        Actor.from_json({key: value for key, value in ACTOR_JSON.items() if key != name})
    with pytest.raises(ValueError):
        Actor.from_json(ACTOR_JSON | {"rights": ["everything"]})


def test_a_local_actor_has_all_rights_and_starts_in_one_step() -> None:
    actor = local_actor("ann", "local-1")
    assert (actor.name, actor.session, actor.remote, actor.address) == ("ann", "local-1", False, "local")
    assert actor.rights == ROLE_RIGHTS[Role.ADMINISTRATOR] == frozenset(Right)


def test_web_and_batch_processes_have_a_lower_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []
    monkeypatch.setattr(os, "nice", steps.append)
    set_nice(NICE_GATEWAY), set_nice(NICE_BATCH)
    assert steps == [5, 10]
    monkeypatch.delattr(os, "nice")
    set_nice(NICE_GATEWAY)


def test_a_system_that_rejects_a_priority_is_tolerated(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "nice", refused)
    set_nice(NICE_GATEWAY)


class Cycle:
    """Object that refers to itself."""

    itself: Cycle


def test_garbage_collection_skips_existing_objects_and_runs_seldom() -> None:
    before, garbage = gc.get_threshold(), Cycle()
    garbage.itself, gone = garbage, weakref.ref(garbage)
    del garbage
    try:
        relax_gc()
        assert gone() is None, "it must be collected before the freeze"
        assert gc.get_threshold() == (before[0], before[1], 100 * before[2])
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)
