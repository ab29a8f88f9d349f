"""The smallest profile of the how-to, in one language: it loads, and its simulated drive runs, reverses and stops."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import ProfileError
from drivebus.i18n import LANGUAGES as LANGUAGES_OF_CATALOGUES
from drivebus.ports import open_port
from drivebus.profiles import toml_file
from drivebus.profiles.load import DATA_DIRECTORY
from drivebus.service.live.views import text_json
from drivebus.testing.virtual_time import run
from drivebus.values import Text

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to"
MOST_LINES = 25
LANGUAGES = set(LANGUAGES_OF_CATALOGUES)
TEXT_KEYS = {"maker", "title", "text", "help", "cause", "remedy", "reason", "procedure", "keypad", "wiring"}


def smallest_profile(page: str = "add-a-profile.md") -> str:
    """Return the profile in the how-to that extends none."""
    blocks = re.findall(r"^```toml\n(.*?)^```", (HOW_TO / page).read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    (found,) = (block for block in blocks if "format = 1" in block and "extends" not in block)
    return str(found)


@pytest.fixture
def mill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Save the smallest profile where a user's profiles are."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    path = tmp_path / "drivebus" / "profiles" / "mill.toml"
    path.parent.mkdir(parents=True)
    path.write_text(smallest_profile(), encoding="utf-8")
    return path


def test_the_smallest_profile_has_at_most_25_lines_and_is_the_same_in_both_pages() -> None:
    assert smallest_profile().count("\n") <= MOST_LINES
    assert smallest_profile() == smallest_profile("add-a-profile.zh.md")


def test_a_plain_string_serves_both_languages(mill: Path) -> None:
    profile = profiles.load("mill")
    assert profile.grade == "draft"
    assert profile.title == Text("Acme V1 of the mill", "Acme V1 of the mill")
    assert profile.signals["output_frequency"].text == Text("output frequency", "output frequency")


def test_a_text_in_chinese_alone_serves_english_too(mill: Path) -> None:
    mill.write_text(mill.read_text().replace('"Acme V1 of the mill"', '{ zh = "磨床变频器" }'), encoding="utf-8")
    assert profiles.load("mill").title == Text("磨床变频器", "磨床变频器")


def test_a_third_language_is_data(mill: Path) -> None:
    """The text of every language reaches programs, and the first one is the English text where there is no other."""
    table = '{ en = "mill", zh = "磨床", de = "Mühle" }'
    mill.write_text(mill.read_text().replace('"Acme V1 of the mill"', table), encoding="utf-8")
    title = profiles.load("mill").title
    assert text_json(title) == {"en": "mill", "zh": "磨床", "de": "Mühle"}
    assert (title.in_language("de"), title.in_language("fr")) == ("Mühle", "mill")
    mill.write_text(mill.read_text().replace(table, '{ de = "Mühle" }'), encoding="utf-8")
    assert profiles.load("mill").title.by_language() == {"en": "Mühle", "zh": "Mühle", "de": "Mühle"}


@pytest.mark.parametrize("language", ["German", "d", "de_DE", "title"])
def test_a_key_that_is_no_language_code_is_rejected(mill: Path, language: str) -> None:
    table = f'{{ en = "mill", {language} = "Mühle" }}'
    mill.write_text(mill.read_text().replace('"Acme V1 of the mill"', table), encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        profiles.load("mill")
    (found,) = caught.value.params["diagnostics"]
    assert found.key == f"title.{language}" and found.line is not None


def test_a_plain_string_replaces_both_languages_of_the_base(mill: Path) -> None:
    """Merged key by key, the Chinese text of the base would stay beside the user's own."""
    mill.write_text('format = 1\nextends = "skf8000"\ntitle = "drive of line 2"\n', encoding="utf-8")
    assert profiles.load("mill").title == Text("drive of line 2", "drive of line 2")


def test_the_smallest_profile_runs_reverses_and_stops_its_simulated_drive(mill: Path) -> None:
    async def tell() -> None:
        port: Any = open_port("sim://mill@3?ramp=2")
        bus = Bus(port)
        await bus.open()
        try:
            drive = Drive(bus, "mill", 3)
            for direction in Direction:
                assert (await drive.run(10.0, direction)).status is OutcomeStatus.CONFIRMED
                assert (await drive.status()).direction is direction
                assert (await drive.read(["output_frequency"]))["output_frequency"].value == pytest.approx(10.0)
                assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
                await asyncio.sleep(3)
                await drive.status()  # the simulated drive computes its motor when it is read
                assert (await drive.status()).state is DriveState.STOPPED
        finally:
            await bus.close()

    run(tell())


def incomplete_texts(value: Any, key: str = "") -> Iterator[Any]:
    """Yield the texts that lack a language."""
    if isinstance(value, str) and key in TEXT_KEYS:
        yield value
    elif isinstance(value, dict) and value.keys() & LANGUAGES:
        yield from [value] if value.keys() < LANGUAGES else []
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from incomplete_texts(part, name)
    elif isinstance(value, list):
        for part in value:
            yield from incomplete_texts(part, key)


@pytest.mark.parametrize("path", sorted(DATA_DIRECTORY.rglob("*.toml")), ids=lambda path: path.stem)
def test_a_profile_that_comes_with_drivebus_has_each_text_in_both_languages(path: Path) -> None:
    """A text in one language is for a user's own file: a page of the other language would show it untranslated."""
    _, data = toml_file.decode_toml(path.read_bytes())
    assert list(incomplete_texts(data)) == [], 'write each as { en = "…", zh = "…" }'
