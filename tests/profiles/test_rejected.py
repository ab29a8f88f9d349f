"""Every file in ``rejected/`` is rejected for exactly the faults listed beside it: location, values and remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivebus import i18n, profiles
from drivebus.errors import ProfileError
from fixtures.rejected_files import all_expected_kinds, check_diagnostics, check_pairs

REJECTED = Path(__file__).parent / "rejected"
FILES = sorted(REJECTED.glob("*.toml"))


def refusal(path: Path) -> ProfileError:
    with pytest.raises(ProfileError) as caught:
        profiles.load(path)
    return caught.value


def test_there_are_at_least_twenty_rejected_files_each_with_its_expectation() -> None:
    assert len(FILES) >= 20
    check_pairs(FILES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_bad_file_is_rejected_with_file_line_key_found_expected_and_remedy(path: Path) -> None:
    check_diagnostics(path, refusal(path))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_rejection_is_reported_in_both_languages_without_an_empty_place(path: Path) -> None:
    error = refusal(path)
    for diagnostic in error.params["diagnostics"]:
        english, chinese = diagnostic.text("en"), diagnostic.text("zh")
        assert Path(diagnostic.file).name in english and Path(diagnostic.file).name in chinese
        assert "profiles." not in english and "profiles." not in chinese
        assert not ({"{", "}"} & set((english + chinese).replace(diagnostic.found.en, "")))
        assert any("一" <= character <= "鿿" for character in chinese)


def test_a_list_that_was_found_has_the_mark_of_the_language() -> None:
    found = refusal(REJECTED / "words-of-bits-and-values.toml").params["diagnostics"][0]
    assert '"bits, values" found' in found.text("en")
    assert '实际为 "bits、values"' in found.text("zh")


def test_two_faults_of_one_file_are_both_named() -> None:
    found = refusal(REJECTED / "two-faults.toml").params["diagnostics"]
    assert [(c.kind, c.line) for c in found] == [("unknown_key", 5), ("type", 8)]


def test_the_first_fault_is_in_the_params_of_the_error() -> None:
    params = refusal(REJECTED / "max-read-zero.toml").params
    assert (params["line"], params["key"], params["found"].en, params["expected"].en) == (
        5,
        "modbus.max_read",
        "0",
        ">= 1",
    )
    assert params["remedy"].zh == "改正数值"
    assert Path(params["file"]).name == "max-read-zero.toml"


def test_a_rejection_names_file_line_value_and_what_was_expected() -> None:
    error = refusal(REJECTED / "wrong-type.toml")
    at = REJECTED / "wrong-type.toml"
    assert str(error) == (
        f'profile rejected (1):\n{at}:5: modbus.max_read: wrong type of value: "4" found, a whole number expected; '
        "numbers without quotes, sentences in quotes, true/false in small letters"
    )


def test_a_toggle_of_direction_can_not_be_offered_under_any_name() -> None:
    for name in ("toggle-direction", "toggle-as-reverse"):
        assert refusal(REJECTED / f"{name}.toml").params["diagnostics"][0].kind == "toggle"


def test_no_parameter_may_stand_on_the_command_word_or_on_an_eeprom_address() -> None:
    """Otherwise a parameter write would bypass the start permissives."""
    assert refusal(REJECTED / "command-as-parameter.toml").params["found"].en == '"2000H"'
    assert refusal(REJECTED / "eeprom-twin-on-the-command-word.toml").params["diagnostics"][0].kind == "duplicate"
    assert refusal(REJECTED / "eeprom-form-as-parameter.toml").params["diagnostics"][0].kind == "eeprom_bit"


def test_every_kind_of_fault_has_its_three_sentences_and_a_file_that_shows_it() -> None:
    """Kinds are the first arguments of ``issue(...)``; six need what can't be shown here: see test_load."""
    source = "".join(path.read_text() for path in Path(profiles.__file__).parent.glob("*.py"))
    kinds = set(re.findall(r'issue\(\s*"([a-z_]+)"', source)) | {"newer", "format"}
    for kind in kinds:
        assert {f"profiles.{part}.{kind}" for part in ("kind", "expected", "remedy")} <= i18n.catalogue("en").keys()
    assert kinds - all_expected_kinds(FILES) == {
        "folder",
        "no_file",
        "no_model",
        "shadows",
        "too_large",
        "unreadable",
    }
