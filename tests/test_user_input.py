"""Texts that a user types: lists of station addresses, and numbers."""

from __future__ import annotations

import pytest

from drivebus import profiles
from drivebus.user_input import HIGHEST_ADDRESS, parse_addresses, parse_decimal


@pytest.mark.parametrize(
    ("text", "addresses"), [("0-3,7", (0, 1, 2, 3, 7)), ("5", (5,)), ("1,1-2", (1, 2)), ("1, 247", (1, 247))]
)
def test_addresses_are_numbers_and_ranges_each_once(text: str, addresses: tuple[int, ...]) -> None:
    assert parse_addresses(text) == addresses


@pytest.mark.parametrize("text", ["", "3-1", "1-", "x", "1_0", "٣", "+1", "248", "1-99999999999", "1,,2"])
def test_an_address_list_in_another_notation_is_rejected(text: str) -> None:
    """Trap: ``int`` takes digits of other scripts and underlines, and a long range fills the memory."""
    with pytest.raises(ValueError):
        parse_addresses(text)


def test_a_drive_at_the_highest_address_of_its_model_can_be_named() -> None:
    """Trap: a model with higher addresses than Modbus is added, and the command line rejects its drives."""
    assert max(profiles.load(model).addresses[1] for model in profiles.models()) == HIGHEST_ADDRESS


@pytest.mark.parametrize("text", ["9" * 400, "-" + "9" * 5_000, "1e999", "1_0", "nan", "inf", ""])
def test_a_number_that_a_double_cannot_hold_is_none(text: str) -> None:
    """``drivebus write … F0.1=`` with 400 digits ended with a traceback."""
    with pytest.raises(ValueError, match="^" + text[:10]):
        parse_decimal(text)
