"""Leases and arms, by themselves: time is an argument (S16, S20)."""

from __future__ import annotations

import pytest

from drivebus.errors import ArmNeeded, NotOwner
from drivebus.plant.access.rights import Role
from drivebus.plant.leases import ARM_S, MOST_ARMS, TTL_S, Arms, Leases
from drivebus.plant.view import LeaseView
from plantkit import LOCAL, remote

ANN, BOB, EVE = remote("ann"), remote("bob"), remote("eve", Role.ENGINEER)
ANN_AGAIN = remote("ann", session="another")


def test_the_times_are_those_of_the_rulings() -> None:
    """6.5, 6.6."""
    assert (TTL_S, ARM_S, MOST_ARMS) == (10, 10, 100)


def test_a_lease_ends_to_the_tick_unless_it_is_renewed() -> None:
    leases = Leases()
    leases.take("a", ANN, 100.0)
    assert leases.get("a", 100.0 + TTL_S - 0.001) is not None
    assert leases.get("a", 100.0 + TTL_S) is None
    with pytest.raises(NotOwner) as refused:
        leases.renew("a", ANN, 100.0 + TTL_S)
    assert (refused.value.key, refused.value.params) == ("plant.no_lease", {"drive": "a"})
    assert leases.renew("a", ANN, 109.0).until == 109.0 + TTL_S
    assert leases.expired(109.0 + TTL_S - 0.001) == []
    assert [lease.drive for lease in leases.expired(109.0 + TTL_S)] == ["a"]
    assert leases.expired(200.0) == []


def test_a_lease_shows_who_has_it_and_for_how_long() -> None:
    leases = Leases()
    leases.take("a", ANN, 100.0)
    lease = leases.get("a", 103.0)
    assert lease is not None and lease.view(103.0) == LeaseView("ann", "session-ann", TTL_S - 3.0)
    assert lease.view(200.0).expires_in_s == 0.0


def test_only_who_has_lost_a_lease_is_told_as_gone() -> None:
    """6.6: not an owner who took it again in time, and not one from whom an engineer took it."""
    leases = Leases()
    leases.take("a", ANN, 0.0)
    leases.take("a", ANN, TTL_S)
    leases.take("b", ANN, 0.0)
    leases.take("b", EVE, 1.0)
    assert leases.expired(TTL_S) == []
    leases.forget("a"), leases.forget("a"), leases.forget("never heard of")
    assert leases.get("a", TTL_S) is None
    assert [lease.drive for lease in leases.expired(100.0)] == ["b"]


def test_a_lease_that_ran_out_is_told_even_when_somebody_was_quicker() -> None:
    """6.6: another's release or taking before the next look must not swallow the lost owner's policy."""
    leases = Leases()
    leases.take("a", ANN, 0.0)
    leases.release("a", BOB, TTL_S)
    assert [lease.actor for lease in leases.expired(TTL_S)] == [ANN]
    leases.take("a", ANN, 20.0)
    leases.take("a", BOB, 20.0 + TTL_S)
    assert [lease.actor for lease in leases.expired(20.0 + TTL_S)] == [ANN]
    assert leases.expired(20.0 + TTL_S) == [] and leases.get("a", 21.0 + TTL_S) is not None


def test_a_lease_belongs_to_a_session_not_to_a_name() -> None:
    leases = Leases()
    leases.take("a", ANN, 0.0)
    for other in (BOB, ANN_AGAIN, LOCAL):
        with pytest.raises(NotOwner):
            leases.need("a", other, 1.0)
        with pytest.raises(NotOwner):
            leases.renew("a", other, 1.0)
        with pytest.raises(NotOwner):
            leases.release("a", other, 1.0)
    with pytest.raises(NotOwner) as refused:
        leases.take("a", BOB, 1.0)
    assert (refused.value.key, refused.value.params) == ("plant.not_owner", {"drive": "a", "owner": "ann"})
    assert leases.take("a", ANN, 1.0) is None
    taken = leases.take("a", EVE, 1.0)
    assert taken is not None and taken.actor is ANN
    leases.release("a", EVE, 2.0)
    leases.release("a", BOB, 2.0)
    leases.need("a", LOCAL, 2.0)
    assert leases.get("a", 2.0).actor is LOCAL  # type: ignore[union-attr]


def test_a_remote_actor_needs_a_lease_of_its_own_before_it_commands() -> None:
    with pytest.raises(NotOwner) as refused:
        Leases().need("a", ANN, 0.0)
    assert refused.value.key == "plant.no_lease"


def test_an_arm_serves_once_in_time_for_one_thing_and_one_session() -> None:
    arms = Arms()
    word = arms.arm("a", ANN, 0.0)
    assert len(word) == 22, "128 bits of chance"
    arms.use(word, "a", ANN, ARM_S)
    for what, actor, now, given in (
        ("a", ANN, ARM_S, word),
        ("b", ANN, 0.0, arms.arm("a", ANN, 0.0)),
        ("a", ANN_AGAIN, 0.0, arms.arm("a", ANN, 0.0)),
        ("a", ANN, ARM_S + 0.001, arms.arm("a", ANN, 0.0)),
        ("a", ANN, 0.0, "made up"),
        ("a", ANN, 0.0, None),
    ):  # fmt: skip
        with pytest.raises(ArmNeeded) as refused:
            arms.use(given, what, actor, now)
        void = ("plant.arm_void", {"what": what, "limit_s": ARM_S})
        assert (refused.value.key, refused.value.params) == (void if given else ("plant.arm_needed", {"what": what}))
    arms.use(None, "a", LOCAL, 0.0)


def test_a_stop_voids_the_arms_of_its_drive_and_of_no_other() -> None:
    arms = Arms()
    one, other = arms.arm("a", ANN, 0.0), arms.arm("b", ANN, 0.0)
    arms.void("a", "group:x")
    with pytest.raises(ArmNeeded):
        arms.use(one, "a", ANN, 0.0)
    arms.use(other, "b", ANN, 0.0)


def test_arms_are_bounded_and_no_two_are_alike() -> None:
    """I12."""
    arms = Arms()
    words = [arms.arm("a", ANN, 0.0) for _ in range(2 * MOST_ARMS)]
    assert len(set(words)) == 2 * MOST_ARMS and len(arms._live) == MOST_ARMS
    arms.use(words[-1], "a", ANN, 0.0)
