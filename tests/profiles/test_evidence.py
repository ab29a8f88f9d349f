"""Evidence of a profile: one line for all languages, or a table of languages; page numbers need no translation."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivebus import families, profiles
from drivebus.errors import ProfileError
from drivebus.profiles.evidence import parse_evidence
from drivebus.profiles.load import DATA_DIRECTORY
from drivebus.profiles.model import Evidence
from drivebus.service.api.profile_json import profile_json
from drivebus.values import Text

NAME = re.compile(r"\S*[A-Z0-9_./§]\S*")
"""Title, file, repository, address, number: the same in every language."""
NAMES_IN_SMALL_LETTERS = {
    "bbctrl-firmware",
    "mbmap-library",
    "ms",
    "python-modbus-vfd-l",
    "rpm",
    "smd",
    "theisth",
    "wb-mqtt-serial",
}
SHIPPED = sorted([*DATA_DIRECTORY.rglob("*.toml"), *Path(families.__path__[0]).rglob("*.toml")])
DIGITS = re.compile(r"\d+")
OWN = 'format = 1\nextends = "c320"\n[faults.1]\ntext = "overload"\nevidence = '


def evidence_of(folder: Path, written: str) -> Evidence | None:
    path = folder / "fan.toml"
    path.write_text(OWN + written, encoding="utf-8")
    return profiles.load(path).faults[1].evidence


@pytest.mark.parametrize(
    ("written", "source"),
    [
        ('"manual V1000 pages 269, 272 and D-12"', Text("V1000 pages 269, 272 and D-12", "V1000 第 269、272、D-12 页")),
        ('"manual page 95: 3000H"', Text("page 95: 3000H", "第 95 页：3000H")),
        ('"manual GD20 manual pages 25 to 31"', Text("GD20 manual pages 25 to 31", "GD20 手册第 25～31 页")),
        ('"manual pages 13 and 14, 2000H"', Text("pages 13 and 14, 2000H", "第 13、14 页, 2000H")),
        ('"manual page 16, 3 Hz"', Text("page 16, 3 Hz", "第 16 页, 3 Hz")),
        ('"manual 维修记录"', Text("维修记录", "维修记录")),
        ('"manual"', Text("", "")),
        ('{ en = "manual page 3: by hand", zh = "manual 第 3 页：手动" }', Text("page 3: by hand", "第 3 页：手动")),
        (
            '{ en = "manual page 3", de = "manual Seite 3" }',
            Text("page 3", "第 3 页", (("de", "Seite 3"),)),
        ),
        ('{ zh = "manual page 3" }', Text("page 3", "page 3")),
    ],
)
def test_a_source_is_a_line_or_a_table_of_languages_and_its_pages_need_no_translation(
    tmp_path: Path, written: str, source: Text
) -> None:
    assert evidence_of(tmp_path, written) == Evidence("manual", source)


@pytest.mark.parametrize(
    "written",
    [
        '"by hand"',
        '{ en = "by hand" }',
        '{ en = "manual page 3", zh = "手册第 3 页" }',
        '{ en = "manual", zh = "user" }',
    ],
)
def test_a_source_of_two_kinds_or_of_none_is_rejected(tmp_path: Path, written: str) -> None:
    with pytest.raises(ProfileError) as caught:
        evidence_of(tmp_path, written)
    assert caught.value.params["key"] == "faults.1.evidence" and caught.value.params["line"] == 5


def test_an_empty_table_is_no_source(tmp_path: Path) -> None:
    with pytest.raises(ProfileError):
        evidence_of(tmp_path, "{}")


def test_evidence_replaces_that_of_the_extended_file_as_a_whole(tmp_path: Path) -> None:
    """A Chinese line of the base would stand beside the English line of another source."""
    base = tmp_path / "base.toml"
    base.write_text(OWN + '{ en = "manual page 3: by hand", zh = "manual 第 3 页：手动" }', encoding="utf-8")
    top = tmp_path / "top.toml"
    top.write_text(f'format = 1\nextends = "{base}"\nfaults.1.evidence = {{ en = "user: log" }}', encoding="utf-8")
    assert profiles.load(top).faults[1].evidence == Evidence("user", Text("log", "log"))


def test_the_api_gives_a_source_in_each_language_beside_the_english_one() -> None:
    """A program may go on to read ``source``; the page shows ``text``."""
    evidence = profile_json(profiles.load("cfw500"))["signals"][0]["evidence"]
    english, chinese = "MarcuSpade/cfw500_modbus: P0003 in 0.1 A", "MarcuSpade/cfw500_modbus：P0003，单位 0.1 A"
    assert evidence == {"kind": "program", "source": english, "text": {"en": english, "zh": chinese}}


def sources(table: dict[str, Any]) -> Iterator[Text]:
    """Yield the source of every evidence inside a file, as it is shown."""
    for key, value in table.items():
        if key.endswith("evidence"):
            yield parse_evidence(value if isinstance(value, dict) else {"en": value}).source
        elif isinstance(value, dict):
            yield from sources(value)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_source_has_no_english_words_in_chinese(path: Path) -> None:
    for source in sources(tomllib.loads(path.read_text(encoding="utf-8"))):
        words = set(re.findall("[a-z][a-z'-]+", NAME.sub(" ", source.zh))) - NAMES_IN_SMALL_LETTERS
        assert not words, source
        assert not re.search("[一-鿿]", source.en), source


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_numbers_of_a_shipped_source_are_the_same_in_both_languages(path: Path) -> None:
    """A page or register that is changed in one language alone is wrong in the other."""
    for source in sources(tomllib.loads(path.read_text(encoding="utf-8"))):
        assert sorted(DIGITS.findall(source.en)) == sorted(DIGITS.findall(source.zh)), source


def test_the_sources_of_all_shipped_files_are_compared() -> None:
    found = [source for path in SHIPPED for source in sources(tomllib.loads(path.read_text(encoding="utf-8")))]
    assert len(found) > 1000 and sum(source.en != source.zh for source in found) > 800


@pytest.mark.parametrize("model", ["ls_m100", "ls_h100"])
def test_a_trip_bit_that_two_manuals_name_differently_has_no_name(model: str) -> None:
    """Bit 7 is heat of the drive in one series of the maker and of the motor in another: neither is this model's."""
    profile = profiles.load(model)
    assert sorted(profile.faults) == [0, 1, 2, 3, 4]
    assert profile.fault_text is not None and "bit {code}" in profile.fault_text.en
    assert "trip_bits" in {question.name for question in profile.open_questions}
