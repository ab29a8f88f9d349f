"""The manual's notation and locators, both ways, and names that a user types."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus import profiles
from drivebus.errors import ProfileError
from drivebus.profiles import notation
from drivebus.profiles.model import NotationRule, Parameter, Signal
from fixtures.drives import writable_registers

SUNFAR = NotationRule("sunfar", "sunfar", 0xFFFF)
DZB100 = NotationRule("dzb100", "dzb100", 80)
CONSECUTIVE = NotationRule("modbus", "consecutive", 450)
HUNDREDS = NotationRule("modbus", "hundreds", 999)
REGISTER = NotationRule("modbus", "register", 0xFFFF)


@pytest.mark.parametrize(
    ("text", "rule", "locator"),
    [
        ("F0.1", SUNFAR, ("parameter", 0x0001)),
        ("F0.01", SUNFAR, ("parameter", 0x0001)),
        ("f1.10", SUNFAR, ("parameter", 0x010A)),
        ("FC.03", SUNFAR, ("parameter", 0x0A03)),
        ("FE.0", SUNFAR, ("parameter", 0x0B00)),
        ("FF.0", SUNFAR, ("parameter", 0x0C00)),
        ("FH.0", SUNFAR, ("parameter", 0x0D00)),
        ("FL.0", SUNFAR, ("parameter", 0x0E00)),
        ("FP.255", SUNFAR, ("parameter", 0x0FFF)),
        ("d.0", SUNFAR, ("monitor", 0)),
        ("d-37", SUNFAR, ("monitor", 37)),
        ("10", DZB100, ("parameter", 10)),
        ("00", DZB100, ("parameter", 0)),
        ("Q01", DZB100, ("query", 1)),
        ("3002H", CONSECUTIVE, ("holding", 0x3002)),
        ("0x3002", CONSECUTIVE, ("holding", 0x3002)),
        ("0FFFFH", CONSECUTIVE, ("holding", 0xFFFF)),
        ("F00.00", CONSECUTIVE, ("holding", 0)),
        ("F1.07", HUNDREDS, ("holding", 107)),
        ("F0.03", HUNDREDS, ("holding", 3)),
        ("F7.02", HUNDREDS, ("holding", 702)),
        ("2001H", HUNDREDS, ("holding", 0x2001)),
        ("12290", REGISTER, ("holding", 12290)),
    ],
)
def test_a_notation_of_the_manual_becomes_its_address(text: str, rule: NotationRule, locator: tuple[str, int]) -> None:
    assert notation.parse_notation(text, rule) == locator


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", SUNFAR),
        ("F0", SUNFAR),
        ("FA.1", SUNFAR),
        ("F10.1", SUNFAR),
        ("F0.256", SUNFAR),
        ("d.256", SUNFAR),
        ("Q01", SUNFAR),
        ("F０.1", SUNFAR),
        ("81", DZB100),
        ("Q04", DZB100),
        ("F0.1", DZB100),
        ("１0", DZB100),
        ("F1.100", HUNDREDS),
        ("F10.00", HUNDREDS),
        ("FC.01", HUNDREDS),
        ("0x1_0", HUNDREDS),
        ("0x10000", REGISTER),
        ("65536", REGISTER),
        ("d.0", REGISTER),
    ],
)
def test_what_the_manual_would_not_write_is_rejected(text: str, rule: NotationRule) -> None:
    with pytest.raises(ProfileError) as caught:
        notation.parse_notation(text, rule)
    assert caught.value.key == "profiles.notation"
    assert caught.value.params["notation"] == text


def test_a_consecutive_index_counts_the_groups_before_it() -> None:
    sizes = {"F00": 30, "F01": 12}
    assert notation.parse_notation("F00.29", CONSECUTIVE, sizes) == ("holding", 29)
    assert notation.parse_notation("F01.00", CONSECUTIVE, sizes) == ("holding", 30)
    assert notation.parse_notation("F02.00", CONSECUTIVE, sizes) == ("holding", 42)


def test_a_consecutive_index_is_not_guessed_without_the_sizes() -> None:
    with pytest.raises(ProfileError) as caught:
        notation.parse_notation("F01.00", CONSECUTIVE)
    assert (caught.value.key, caught.value.params["groups"]) == ("profiles.unplaced", ("F00",))
    with pytest.raises(ProfileError) as caught:
        notation.parse_notation("F02.01", CONSECUTIVE, {"F00": 30, "F01": 12})
    assert (caught.value.key, caught.value.params["groups"]) == ("profiles.unplaced", ("F02",))


def test_an_item_beyond_its_group_is_no_item_of_the_next_group() -> None:
    with pytest.raises(ProfileError) as caught:
        notation.parse_notation("F00.30", CONSECUTIVE, {"F00": 30, "F01": 12})
    assert (caught.value.key, caught.value.params["size"]) == ("profiles.beyond_group", 30)


@pytest.mark.parametrize("model", profiles.models())
def test_every_listed_notation_finds_itself_and_is_shown_as_listed(model: str) -> None:
    profile = profiles.load(model)
    for signal in profile.signals.values():
        assert notation.find_entry(profile, signal.name) is signal
        assert notation.find_entry(profile, signal.notation) is signal
        assert notation.format_locator(signal.locator, profile) == signal.notation
    for parameter in profile.parameters.values():
        assert notation.find_entry(profile, parameter.notation) is parameter
        assert notation.format_locator(parameter.locator, profile) == parameter.notation


@pytest.mark.parametrize("model", [name for name in profiles.models() if profiles.load(name).family == "modbus"])
@pytest.mark.parametrize("space", ["holding", "input", "coil", "discrete"])
def test_every_modbus_address_is_shown_in_a_form_that_means_the_same_when_it_is_typed(model: str, space: str) -> None:
    """C34FH and FA00H were rejected, and the 0049H of a coil was read as a holding register."""
    profile = profiles.load(model)
    for place in (*range(0, 0x10000, 0x1111), 0x0010, 0x0049, 0xC34F, 0xFA00):
        shown = notation.format_locator((space, place), profile)
        for typed in (shown, shown.lower()):
            assert notation.find_entry(profile, typed).locator == (space, place)


def test_an_address_with_its_space_is_read_and_never_written() -> None:
    """It is a bare address like 0049H: its meaning is not known."""
    for model in ("h100", "vc660", "df800"):
        found = notation.find_entry(profiles.load(model), "coil:0049H")
        assert isinstance(found, Parameter) and not found.writable and not found.listed
        assert found.locator == ("coil", 0x49) and found.notation == "coil:0049H"


@pytest.mark.parametrize("text", ["EACH", "BH", "FFH", "1FA00FH", "FA00", "GA00H", "register:0049H", "coil:", "coil:x"])
def test_letters_are_no_address_unless_all_four_digits_stand_before_the_h(text: str) -> None:
    with pytest.raises(ProfileError):
        notation.find_entry(profiles.load("vc660"), text)


@pytest.mark.parametrize("group", "0123456789CEFHLP")
def test_every_c320_address_is_shown_in_a_form_that_is_read_back(group: str) -> None:
    profile = profiles.load("c320")
    for item in range(256):
        locator = notation.parse_notation(f"F{group}.{item}", SUNFAR)
        assert notation.parse_notation(notation.format_locator(locator, profile), SUNFAR) == locator


@pytest.mark.parametrize(("model", "highest"), [("dzb100", 80), ("df800", 999)])
def test_every_parameter_address_is_shown_in_a_form_that_is_read_back(model: str, highest: int) -> None:
    profile = profiles.load(model)
    space = "parameter" if model == "dzb100" else "holding"
    for index in range(highest + 1):
        shown = notation.format_locator((space, index), profile)
        assert notation.parse_notation(shown, profile.notation) == (space, index)


def test_a_name_may_be_a_signal_in_any_case() -> None:
    found = notation.find_entry(profiles.load("vc660"), " Output_Frequency ")
    assert isinstance(found, Signal) and found.locator == ("holding", 0x3002)


def test_an_unlisted_parameter_can_be_read_and_written_raw() -> None:
    found = notation.find_entry(profiles.load("c320"), "F2.07")
    assert isinstance(found, Parameter)
    assert (found.notation, found.locator, found.listed, found.writable) == ("F2.7", ("parameter", 0x0207), False, True)


def test_a_register_for_commands_is_named_as_one() -> None:
    """``read 2000H`` of a VC660 had "not described in the profile", and the drive rejects the read."""
    profile = profiles.load("vc660")
    for name in ("2000H", "2001H"):
        assert "register for commands" in notation.find_entry(profile, name).text.en
    assert "raw word" in notation.find_entry(profile, "3FFFH").text.en


def test_an_unlisted_register_is_never_written() -> None:
    """200BH of the guide's examples belongs to no table."""
    found = notation.find_entry(profiles.load("vc660"), "200BH")
    assert isinstance(found, Parameter)
    assert (found.locator, found.listed, found.writable) == (("holding", 0x200B), False, False)
    assert 0x200B not in writable_registers(profiles.load("vc660"))


def test_the_command_word_is_no_parameter_under_any_spelling() -> None:
    for model in ("vc660", "df800"):
        for name in ("2000H", "0x2000", "2001H", "0x2001"):
            found = notation.find_entry(profiles.load(model), name)
            assert isinstance(found, Parameter) and not found.writable


def test_a_parameter_whose_index_is_unknown_names_what_to_supply() -> None:
    with pytest.raises(ProfileError) as caught:
        notation.find_entry(profiles.load("vc660"), "F01.00")
    assert caught.value.key == "profiles.unplaced"
    assert "[group_sizes]" in str(caught.value)
    assert isinstance(notation.find_entry(profiles.load("vc660"), "F00.02"), Parameter)


@pytest.mark.parametrize("sizes", [{}, {"F00": 30}])
def test_a_group_behind_the_last_of_the_model_is_answered_with_its_groups(sizes: dict[str, int]) -> None:
    """The size of 99 groups was asked for, of a model that has seven."""
    with pytest.raises(ProfileError) as caught:
        notation.find_entry(replace(profiles.load("vc660"), group_sizes=sizes), "F99.01")
    assert (caught.value.key, caught.value.params["groups"]) == ("profiles.no_group", ("F00", "F01", "F04", "F06"))


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(ProfileError) as caught:
        notation.find_entry(profiles.load("c320"), "output_frequence")
    assert caught.value.key == "profiles.unknown_name_near"
    assert str(caught.value) == (
        "c320 has no output_frequence: write a signal's name or a notation such as "
        "F0.1, F1.10 (F1.0-F1.255), FC.03, d.0 (d.0-d.255); near: output_frequency, output_voltage"
    )


@pytest.mark.parametrize(
    ("model", "name", "span"),
    [("dzb100", "81", "00-80"), ("c320", "F3.300", "F1.0-F1.255"), ("c320", "F0.300", "F1.0-F1.255")],
)
def test_a_number_out_of_range_is_answered_with_the_range_and_no_other_parameter(
    model: str, name: str, span: str
) -> None:
    with pytest.raises(ProfileError) as caught:
        notation.find_entry(profiles.load(model), name)
    assert caught.value.key == "profiles.unknown_name"
    assert span in str(caught.value) and "near" not in str(caught.value)


def test_a_parameter_with_an_explicit_index_is_found_however_its_zeros_are_written() -> None:
    profile = profiles.load("vc660")
    assert notation.find_entry(profile, "F0.2") is notation.find_entry(profile, "F00.02")


def test_a_signal_whose_notation_is_no_address_is_found_by_it_in_any_case() -> None:
    """The register of such a signal stands in the profile, as that of a parameter does."""
    vc660 = profiles.load("vc660")
    signal = replace(vc660.signals["output_frequency"], notation="U0-01")
    profile = replace(vc660, signals={**vc660.signals, signal.name: signal})
    assert notation.find_entry(profile, " u0-01") is signal
