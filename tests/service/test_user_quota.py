"""Places that users share: several together leave some to the others, and a free place is never lost."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from drivebus.service.user_quota import UserQuota


def held_by(quota: UserQuota, users: list[str | None], stack: ExitStack) -> list[int]:
    """Let each user take all places that it gets, one user after the other; return how many."""
    counts = []
    for user in users:
        before = quota.held
        while quota.has_place(user):
            stack.enter_context(quota.place(user))
        counts.append(quota.held - before)
    return counts


@pytest.mark.parametrize(
    ("places", "expected"), [(20, [10, 5, 3, 1, 1, 0]), (300, [150, 75, 38, 19, 9, 5, 2, 1, 1, 0]), (1, [1, 0])]
)
def test_each_user_gets_half_of_the_places_that_are_free(places: int, expected: list[int]) -> None:
    with ExitStack() as stack:
        assert held_by(UserQuota(places), [f"user-{number}" for number in range(len(expected))], stack) == expected


def test_without_a_user_every_free_place_is_given() -> None:
    with ExitStack() as stack:
        quota = UserQuota(20)
        assert held_by(quota, ["eve", None, "bob"], stack) == [10, 10, 0]


def test_a_place_is_free_again_after_its_block_however_it_ends() -> None:
    quota = UserQuota(2)
    for _ in range(2):
        with pytest.raises(KeyError), quota.place("eve"):
            assert not quota.has_place("eve") and quota.has_place("bob")
            raise KeyError
        assert quota.held == 0 and quota.has_place("eve")
