"""Control leases and arm tokens alone: time is an argument."""

from __future__ import annotations

import pytest

from drivebus.errors import ArmRequired, ControlNotHeld
from drivebus.service.auth.rights import Role
from drivebus.service.control.leases import (
    ARM_TTL_S,
    ENDED_SESSION_TTL_S,
    LEASE_TTL_S,
    MAX_ARM_TOKENS,
    ArmTokens,
    ControlLeases,
    arm_target_of_test,
)
from drivebus.service.live.views import LeaseObject
from drivebus.service.runtime.utc_clock import UtcClock
from fixtures.service import LOCAL, remote_actor

ANN, BOB, EVE = remote_actor("ann"), remote_actor("bob"), remote_actor("eve", Role.ENGINEER)
ANN_AGAIN = remote_actor("ann", session="another")


def test_the_documented_times_and_limits() -> None:
    assert (LEASE_TTL_S, ARM_TTL_S, MAX_ARM_TOKENS) == (10, 10, 100)


def test_a_lease_ends_exactly_at_its_expiry_unless_it_is_renewed() -> None:
    leases = ControlLeases()
    leases.take("a", ANN, 100.0)
    assert leases.get("a", 100.0 + LEASE_TTL_S - 0.001) is not None
    assert leases.get("a", 100.0 + LEASE_TTL_S) is None
    with pytest.raises(ControlNotHeld) as rejected:
        leases.renew("a", ANN, 100.0 + LEASE_TTL_S)
    assert (rejected.value.key, rejected.value.params) == ("plant.no_lease", {"drive": "a"})
    assert leases.renew("a", ANN, 109.0).expires_at == 109.0 + LEASE_TTL_S
    assert leases.pop_expired(109.0 + LEASE_TTL_S - 0.001) == []
    assert [lease.drive for lease in leases.pop_expired(109.0 + LEASE_TTL_S)] == ["a"]
    assert leases.pop_expired(200.0) == []


def test_the_view_of_a_lease_has_its_owner_and_expiry() -> None:
    leases = ControlLeases()
    leases.take("a", ANN, 100.0)
    lease = leases.get("a", 103.0)
    clock = UtcClock(lambda: 103.0, lambda: 1_000_000)
    assert lease is not None
    assert lease.view(clock) == LeaseObject("ann", "session-ann", True, 1_000_000 + round((LEASE_TTL_S - 3.0) * 1000))


def test_only_a_lease_that_ran_out_is_returned_as_expired() -> None:
    """A lease that was taken again at once, or that an engineer took over, is not returned."""
    leases = ControlLeases()
    leases.take("a", ANN, 0.0)
    leases.take("a", ANN, LEASE_TTL_S)
    leases.take("b", ANN, 0.0)
    leases.take("b", EVE, 1.0)
    assert leases.pop_expired(LEASE_TTL_S) == []
    leases.remove_drive("a"), leases.remove_drive("a"), leases.remove_drive("unknown")
    assert leases.get("a", LEASE_TTL_S) is None
    assert [lease.drive for lease in leases.pop_expired(100.0)] == ["b"]


def test_an_expired_lease_is_returned_also_after_another_session_took_the_drive() -> None:
    """A release or a new lease before the next cycle must not suppress the drive's policy for a lost client."""
    leases = ControlLeases()
    leases.take("a", ANN, 0.0)
    leases.release("a", BOB, LEASE_TTL_S)
    assert [lease.actor for lease in leases.pop_expired(LEASE_TTL_S)] == [ANN]
    leases.take("a", ANN, 20.0)
    leases.take("a", BOB, 20.0 + LEASE_TTL_S)
    assert [lease.actor for lease in leases.pop_expired(20.0 + LEASE_TTL_S)] == [ANN]
    assert leases.pop_expired(20.0 + LEASE_TTL_S) == [] and leases.get("a", 21.0 + LEASE_TTL_S) is not None


def test_a_session_that_has_just_ended_takes_no_control_and_a_token_with_its_right_again_does_later() -> None:
    leases = ControlLeases()
    leases.take("a", ANN, 0.0)
    assert [lease.drive for lease in leases.end_session(ANN.session, 1.0)] == ["a"]
    for at in (1.0, 1.0 + ENDED_SESSION_TTL_S - 0.001):
        with pytest.raises(ControlNotHeld):
            leases.take("a", ANN, at)
    leases.take("b", BOB, 1.0)
    leases.take("a", ANN, 1.0 + ENDED_SESSION_TTL_S)


def test_a_lease_belongs_to_a_session_not_to_a_name() -> None:
    leases = ControlLeases()
    leases.take("a", ANN, 0.0)
    for other in (BOB, ANN_AGAIN, LOCAL):
        with pytest.raises(ControlNotHeld):
            leases.require("a", other, 1.0)
        with pytest.raises(ControlNotHeld):
            leases.renew("a", other, 1.0)
        with pytest.raises(ControlNotHeld):
            leases.release("a", other, 1.0)
    with pytest.raises(ControlNotHeld) as rejected:
        leases.take("a", BOB, 1.0)
    assert (rejected.value.key, rejected.value.params) == ("plant.not_owner", {"drive": "a", "owner": "ann"})
    assert leases.take("a", ANN, 1.0) is None
    taken = leases.take("a", EVE, 1.0)
    assert taken is not None and taken.actor is ANN
    leases.release("a", EVE, 2.0)
    leases.release("a", BOB, 2.0)
    leases.require("a", LOCAL, 2.0)
    assert leases.get("a", 2.0).actor is LOCAL  # type: ignore[union-attr]


def test_a_remote_actor_needs_its_own_lease_to_command() -> None:
    with pytest.raises(ControlNotHeld) as rejected:
        ControlLeases().require("a", ANN, 0.0)
    assert rejected.value.key == "plant.no_lease"


def test_an_arm_token_is_valid_once_in_time_for_one_target_and_one_session() -> None:
    arms = ArmTokens()
    word = arms.issue("a", ANN, 0.0)
    assert len(word) == 22, "128 random bits"
    arms.consume(word, "a", ANN, ARM_TTL_S)
    for target, actor, now, token in (
        ("a", ANN, ARM_TTL_S, word),
        ("b", ANN, 0.0, arms.issue("a", ANN, 0.0)),
        ("a", ANN_AGAIN, 0.0, arms.issue("a", ANN, 0.0)),
        ("a", ANN, ARM_TTL_S + 0.001, arms.issue("a", ANN, 0.0)),
        ("a", ANN, 0.0, "made up"),
        ("a", ANN, 0.0, None),
    ):
        with pytest.raises(ArmRequired) as rejected:
            arms.consume(token, target, actor, now)
        void = ("plant.arm_void", {"what": target, "limit_s": ARM_TTL_S})
        assert (rejected.value.key, rejected.value.params) == (
            void if token else ("plant.arm_needed", {"what": target})
        )
    arms.consume(None, "a", LOCAL, 0.0)


def test_a_stop_revokes_the_arm_tokens_of_its_drive_and_of_no_other() -> None:
    arms = ArmTokens()
    revoked, other = arms.issue("a", ANN, 0.0), arms.issue("b", ANN, 0.0)
    arms.revoke("a", "group:x")
    with pytest.raises(ArmRequired):
        arms.consume(revoked, "a", ANN, 0.0)
    arms.consume(other, "b", ANN, 0.0)


def test_a_token_for_the_test_of_one_drive_starts_neither_the_drive_nor_the_test_of_another() -> None:
    arms = ArmTokens()
    for other in ("a", "group:a", arm_target_of_test("b")):
        with pytest.raises(ArmRequired):
            arms.consume(arms.issue(arm_target_of_test("a"), ANN, 0.0), other, ANN, 0.0)
    arms.consume(arms.issue(arm_target_of_test("a"), ANN, 0.0), arm_target_of_test("a"), ANN, 0.0)


def test_a_further_arm_token_drops_only_those_that_are_over() -> None:
    arms = ArmTokens()
    last_moment = arms.issue("a", ANN, 0.0)
    arms.issue("a", ANN, ARM_TTL_S)
    arms.consume(last_moment, "a", ANN, ARM_TTL_S)


def test_arm_tokens_are_unique_and_the_oldest_of_a_session_gives_way() -> None:
    arms = ArmTokens()
    words = [arms.issue("a", ANN, 0.0) for _ in range(2 * MAX_ARM_TOKENS)]
    assert len(set(words)) == 2 * MAX_ARM_TOKENS and list(arms._tokens) == words[MAX_ARM_TOKENS:]
    arms.consume(words[-1], "a", ANN, 0.0)


def test_arm_tokens_of_one_session_never_push_out_those_of_another() -> None:
    """Else an operator whose program arms ten times a second would keep the others from starting anything."""
    arms = ArmTokens()
    other = arms.issue("b", BOB, 0.0)
    for number in range(5 * MAX_ARM_TOKENS):
        arms.issue("a", ANN, number / 100)
    arms.consume(other, "b", BOB, ARM_TTL_S)
    assert len(arms._tokens) == MAX_ARM_TOKENS
    arms.issue("a", ANN, 100.0)
    assert len(arms._tokens) == 1, "those that are too old are dropped"
