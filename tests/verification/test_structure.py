"""The hand-written lists of ``verification/structure_walks.json`` name files and functions of today's code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from verification.structure import WALKS, checked_files, checked_walk

ROOT = Path(__file__).resolve().parents[2]
LISTS = json.loads(WALKS.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", LISTS["walks"])
def test_every_function_of_a_walk_exists(name: str) -> None:
    assert checked_walk(ROOT, LISTS["walks"][name]["after"])


@pytest.mark.parametrize("name", LISTS["additions"])
def test_every_file_that_an_addition_changes_exists(name: str) -> None:
    assert checked_files(ROOT, LISTS["additions"][name]["after"])


@pytest.mark.parametrize("walk", ["bus/core.py: submit no_such_function", "bus/no_such_file.py: submit"])
def test_a_function_that_does_not_exist_is_rejected(walk: str) -> None:
    with pytest.raises(ValueError, match="has no function"):
        checked_walk(ROOT, [walk])


def test_a_file_that_does_not_exist_is_rejected_unless_it_is_new() -> None:
    assert checked_files(ROOT, ["src/drivebus/no_such_file.py+"])
    with pytest.raises(ValueError, match=r"has no src/drivebus/no_such_file\.py"):
        checked_files(ROOT, ["src/drivebus/no_such_file.py"])
