"""Which commit a report is of."""

from __future__ import annotations

import subprocess
from pathlib import Path

from drivebus.lab.report import commit


def test_a_report_names_its_commit_and_whether_what_it_tried_was_changed(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        own = ["-c", "user.name=a", "-c", "user.email=a@b"]
        return subprocess.run(["git", *own, *words], cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    assert commit(tmp_path) == ""
    git("init", "-q")
    for name in ("src", "docs"):
        (tmp_path / name).write_text("1")
    git("add", ".")
    git("commit", "-q", "-m", "x")
    head = git("rev-parse", "--short=12", "HEAD").strip()
    assert commit(tmp_path) == head
    (tmp_path / "docs").write_text("2")
    assert (commit(tmp_path), commit(tmp_path, "src"), commit(tmp_path, "src", "docs")) == (
        f"{head}-dirty", head, f"{head}-dirty",
    )  # fmt: skip
