"""Commit and interpreter of a report."""

from __future__ import annotations

import json
import platform
import subprocess
from pathlib import Path

import pytest

from verification import report
from verification.__main__ import main
from verification.report import current_commit


def test_a_report_names_its_commit_and_local_changes(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        own = ["-c", "user.name=a", "-c", "user.email=a@b"]
        return subprocess.run(["git", *own, *words], cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    assert current_commit(tmp_path) == ""
    git("init", "-q")
    for name in ("src", "docs"):
        (tmp_path / name).write_text("1")
    git("add", ".")
    git("commit", "-q", "-m", "x")
    head = git("rev-parse", "--short=12", "HEAD").strip()
    assert current_commit(tmp_path) == head
    (tmp_path / "docs").write_text("2")
    assert (current_commit(tmp_path), current_commit(tmp_path, "src"), current_commit(tmp_path, "src", "docs")) == (
        f"{head}-dirty",
        head,
        f"{head}-dirty",
    )


def test_a_report_names_its_interpreter_and_the_commit_at_the_start_of_its_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The checkout may change while a campaign runs for hours."""
    heads = iter(("began", "went on"))
    monkeypatch.setattr(report, "current_commit", lambda: next(heads))
    main(["matrix", "--budget", "1", "--report", str(tmp_path)])
    found = json.loads((tmp_path / "campaign-matrix.json").read_text(encoding="utf-8"))
    assert found["commit"] == "began"
    assert found["machine"]["python"] == f"{platform.python_implementation()} {platform.python_version()}"


def test_a_report_is_written_before_its_summary_is_printed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """``| head -1`` closes the pipe: the run of an hour ended with a traceback and without its report."""

    def print_to_closed_pipe(*texts: object, file: object = None) -> None:
        if file is None:
            raise BrokenPipeError

    monkeypatch.setattr("builtins.print", print_to_closed_pipe)
    with pytest.raises(BrokenPipeError):
        main(["matrix", "--budget", "1", "--report", str(tmp_path)])
    assert (tmp_path / "campaign-matrix.json").exists()
