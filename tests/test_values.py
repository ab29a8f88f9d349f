"""Scale of a value: numbers that must fit the words of a drive."""

from __future__ import annotations

import pytest

from drivebus.values import Scale


@pytest.mark.parametrize(("value", "word"), [(327.67, 0x7FFF), (0.0, 0), (-0.01, 0xFFFF), (-327.68, 0x8000)])
def test_a_signed_number_keeps_its_sign(value: float, word: int) -> None:
    scale = Scale(0.01, coding="signed", decimals=2)
    assert (scale.raw(value), scale.value(word)) == (word, value)


@pytest.mark.parametrize("value", [327.68, 400.0, -327.69])
def test_a_number_whose_word_has_the_other_sign_is_refused(value: float) -> None:
    """Trap: 400 Hz is the word 9C40H, which the drive reads as -255.36 Hz: the motor runs the other way."""
    with pytest.raises(ValueError, match="does not fit"):
        Scale(0.01, coding="signed", decimals=2).raw(value)
