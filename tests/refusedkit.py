"""Files that must be refused, each beside the complaints that it must bring (`NAME.json`)."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.profiles.complaint import cut


def expected(path: Path) -> list[dict[str, Any]]:
    """What must be said of a file."""
    wanted: list[dict[str, Any]] = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    return wanted


def all_expected(files: Iterable[Path]) -> set[str]:
    """Every kind of complaint that the files bring."""
    return {complaint["kind"] for path in files for complaint in expected(path)}


def check(path: Path, refused: DrivebusError) -> None:
    """Exactly those complaints, word by word; HERE stands for the folder of the file."""
    found, wanted = refused.params["complaints"], expected(path)
    assert [(Path(one.file).name, one.line, one.kind, one.key) for one in found] == [
        (want["file"], want["line"], want["kind"], want["key"]) for want in wanted
    ]
    for complaint, want in zip(found, wanted, strict=True):
        assert complaint.expected.en == want["expected"]
        assert complaint.remedy.en == want["remedy"]
        if complaint.kind != "toml":  # tomllib's own words change with Python
            assert complaint.found == cut(want["found"].replace("HERE", str(path.parent)))


def check_pairs(files: list[Path]) -> None:
    """Every file has its expectation, and every expectation its file."""
    assert {path.stem for path in files[0].parent.glob("*.json")} == {path.stem for path in files}
