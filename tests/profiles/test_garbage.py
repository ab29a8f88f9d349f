"""Whatever value stands wherever: a profile is accepted or refused with sentences, nothing else happens."""

from __future__ import annotations

import copy
import random
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from drivebus import profiles
from drivebus.profiles import check, diagnostics
from drivebus.profiles.build import build_profile
from drivebus.profiles.schema import ProfileFile

Path_ = tuple[str, ...]
GARBAGE = ["x", "", "１", -1, 0, 1.5, 10**9, True, float("nan"), float("inf"), [], ["x"], {}, {"en": 1}]
DATA = Path(profiles.__file__).parent / "data"
FILES = sorted(path for path in DATA.glob("*/*.toml") if path.stem in ("c320", "dzb100", "vc660", "df800"))


def keys(table: dict[str, Any], above: Path_ = ()) -> Iterator[Path_]:
    for key, value in table.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from keys(value, (*above, key))


def judged(data: dict[str, Any]) -> str:
    """``accepted``, or the kinds of its faults; every sentence is made on the way."""
    try:
        given = ProfileFile.model_validate(data)
    except ValidationError as error:
        found = diagnostics.issues_from_pydantic(error, ProfileFile, data)
    else:
        found = list(check.check_profile(given))
        if not found:
            return build_profile(given, "garbage").model and "accepted"
    sentences = [
        diagnostics.to_diagnostic(issue, "garbage.toml", 1).text(language)
        for issue in found
        for language in ("en", "zh")
    ]
    assert not any("profiles." in sentence.split("：")[0] for sentence in sentences)
    return ",".join(issue.kind for issue in found)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_garbage_at_any_key_is_judged_and_never_crashes(path: Path) -> None:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    chance = random.Random(path.stem)
    places = list(keys(data))
    verdicts = set()
    for _ in range(400):
        broken, place = copy.deepcopy(data), chance.choice(places)
        table = broken
        for key in place[:-1]:
            table = table[key]
        if chance.random() < 0.1:
            del table[place[-1]]
        else:
            table[place[-1]] = chance.choice(GARBAGE)
        verdicts.add(judged(broken))
    assert {"accepted", "type", "missing_key"} <= verdicts
