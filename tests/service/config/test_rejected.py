"""Every file in ``rejected/`` is rejected for exactly the faults listed beside it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivebus import i18n
from drivebus.errors import ConfigurationError
from drivebus.profiles import toml_file
from drivebus.service import config
from drivebus.simulator.port import find_simulated_bus
from drivebus.values import Text
from drivebus.web import gateway
from fixtures.rejected_files import all_expected_kinds, check_diagnostics, check_pairs

REJECTED = Path(__file__).parents[1] / "rejected"
FILES = sorted(REJECTED.glob("*.toml"))


def refusal(path: Path) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        config.load(path)
    return caught.value


def test_there_are_at_least_twenty_five_rejected_files_each_with_its_expectation() -> None:
    assert len(FILES) >= 25
    check_pairs(FILES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_an_invalid_plant_is_rejected_with_file_line_key_found_expected_and_remedy(path: Path) -> None:
    check_diagnostics(path, refusal(path))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_rejection_is_complete_in_both_languages(path: Path) -> None:
    for diagnostic in refusal(path).params["diagnostics"]:
        english, chinese = diagnostic.text("en"), diagnostic.text("zh")
        assert Path(diagnostic.file).name in english and Path(diagnostic.file).name in chinese
        assert not re.search(r"(plant_config|profiles|expression)\.[a-z]", english + chinese)
        shown = (english + chinese).replace(diagnostic.found.en, "").replace(diagnostic.expected.en, "")
        assert not ({"{", "}"} & set(shown.replace(diagnostic.expected.zh, "")))
        assert any("一" <= character <= "鿿" for character in chinese)


def test_every_fault_of_a_file_is_reported_at_once() -> None:
    """Wrong types and missing keys hide no other fault, and what depends on them is not reported as unknown."""
    found = refusal(REJECTED / "many-faults.toml").params
    assert found["count"] == 8
    assert [diagnostic.line for diagnostic in found["diagnostics"]] == [6, 9, 12, 14, 16, 17, 19, 19]


def test_ratios_without_a_leader_are_listed_with_the_mark_of_the_language() -> None:
    text = (REJECTED / "group-without-leader.toml").read_text(encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        config.loads(text.replace("{ fan = 0.5 }", "{ fan = 0.5, pump = 0.5 }", 1))
    first = caught.value.params["diagnostics"][0]
    assert (first.kind, first.found) == ("no_leader", Text('"fan, pump"', '"fan、pump"'))


def test_two_protocol_families_on_one_bus_are_rejected() -> None:
    assert [diagnostic.kind for diagnostic in refusal(REJECTED / "mixed-families.toml").params["diagnostics"]] == [
        "mixed"
    ]


def test_the_web_gateway_on_every_address_needs_a_certificate() -> None:
    kinds = [diagnostic.kind for diagnostic in refusal(REJECTED / "web-without-certificate.toml").params["diagnostics"]]
    assert kinds == ["tls"]
    for host in ("127.0.0.1", "127.0.0.9", "::1", "localhost"):
        text = (REJECTED / "web-without-certificate.toml").read_text().replace("0.0.0.0", host)
        assert config.loads(text).gateway("web").settings.host == host
    closed = (REJECTED / "web-without-certificate.toml").read_text() + "enabled = false\n"
    assert config.loads(closed).gateway("web").enabled is False


def test_no_issue_carries_a_control_character_into_a_log() -> None:
    text = (REJECTED / "unknown-bus.toml").read_text().replace("sim://c320@1-3", "x\\u001b[31m\\u202e")
    with pytest.raises(ConfigurationError) as caught:
        config.loads(text.replace('"aa"', '"a\\nb"'))
    kinds = [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]]
    assert kinds == ["control_character", "port_url", "pattern", "control_character"]
    for language in ("en", "zh"):
        reply_text = caught.value.text(language)
        assert reply_text.count("\n") == len(kinds), "a line each"
        assert not set(reply_text) & {"\x1b", "\u202e"}


@pytest.mark.parametrize("name", ["", "name=checked&"])
def test_a_simulated_bus_is_checked_with_and_without_a_name(name: str) -> None:
    """``check`` accepted ``sim://…?name=x&drives=3``, which ``serve`` rejects; a check leaves no bus in its process."""
    text = (REJECTED / "unknown-bus.toml").read_text().replace('bus = "aa"', 'bus = "a"')
    with pytest.raises(ConfigurationError) as caught:
        config.loads(text.replace("sim://c320@1-3", f"sim://c320@1-3?{name}drives=3"))
    assert [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]] == ["port_url"]
    config.loads(text.replace("sim://c320@1-3", f"sim://c320@1-3?{name}drives=9600-8E1"))
    with pytest.raises(KeyError):
        find_simulated_bus("checked")


def test_a_password_in_a_database_url_is_not_repeated() -> None:
    reply_text = refusal(REJECTED / "history-url.toml").text("en")
    assert "secret" not in reply_text and "root" in reply_text


def test_a_missing_or_unreadable_file_is_reported(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.toml").params["diagnostics"][0].kind == "no_plant_file"
    assert refusal(tmp_path).params["diagnostics"][0].kind == "folder"
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * 1_000_001)
    assert refusal(large).params["diagnostics"][0].kind == "too_large"


def test_at_most_a_hundred_faults_are_reported() -> None:
    with pytest.raises(ConfigurationError) as caught:
        config.loads('format = 1\n[plant]\nid = "p"\n' + "".join(f"x{n} = 1\n" for n in range(5000)))
    assert caught.value.params["count"] == 100


def test_brackets_without_end_are_rejected_as_a_syntax_error() -> None:
    with pytest.raises(ConfigurationError) as caught:
        config.loads("format = 1\nx = " + "[" * 100_000)
    assert caught.value.params["diagnostics"][0].kind == "toml"


@pytest.mark.parametrize(("language", "sentence"), [("en", "blank in the name of a table"), ("zh", "表名中有空格")])
def test_a_blank_in_a_table_name_is_named_with_the_line_in_the_language_of_the_user(
    language: str, sentence: str
) -> None:
    """The message of tomllib, in English, did not name the blank."""
    with pytest.raises(ConfigurationError) as caught:
        config.loads('format = 1\n[plant]\nid = "p"\n[drive.Pump 1]\n')
    text = caught.value.params["diagnostics"][0].text(language)
    assert sentence in text and ":4" in text and "[drive.Pump 1]" in text and "declaration" not in text


@pytest.mark.parametrize("header", ["[drive.pump", "[drive.pump ]]", "[drive.pump # 1]", "[drive.泵]"])
def test_another_fault_of_a_table_name_is_no_blank(header: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        config.loads(f'format = 1\n[plant]\nid = "p"\n{header}\n')
    assert caught.value.params["diagnostics"][0].kind == "toml"


def test_every_kind_of_fault_has_three_texts_and_a_rejected_file() -> None:
    files = [*Path(config.__file__).parent.glob("*.py"), Path(toml_file.__file__), Path(gateway.__file__)]
    source = "".join(path.read_text() for path in files)
    kinds = set(re.findall(r'issue\(\s*"([a-z_]+)"', source)) | {"newer", "format"}
    known = i18n.catalogue("en").keys()
    for kind in kinds:
        for part in ("kind", "expected", "remedy"):
            assert f"plant_config.{part}.{kind}" in known or f"profiles.{part}.{kind}" in known
    # A file alone does not show the first two: its size, and a check over the API. The last is a warning.
    assert kinds - all_expected_kinds(FILES) == {
        "too_large",
        "model_outside",
        "long_interval",
        "unverified_database",
    }
