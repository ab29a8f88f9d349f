"""``drivebus audit``: its output and exit codes."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivebus.cli.main import cli
from drivebus.service.audit import AuditEntry, AuditTrail
from fixtures.audit import LI, new_trail, written_trail

EDIT = (b'"frequency_hz":5.0', b'"frequency_hz":9.0')


def ask(*words: str, language: str = "en", env: dict[str, str] | None = None) -> Result:
    return CliRunner().invoke(cli, ["audit", *words, "--lang", language], env=env)


def edited(made: AuditTrail) -> None:
    made.paths.current.write_bytes(made.paths.current.read_bytes().replace(*EDIT))


def test_a_whole_trail_is_reported_as_whole(tmp_path: Path) -> None:
    found = ask("verify", str(written_trail(tmp_path).paths.folder))
    assert found.exit_code == 0
    assert "Complete and unchanged: 10 records" in found.output and "record 10" in found.output


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_edit_is_named_with_its_file_and_line(tmp_path: Path, language: str) -> None:
    made = written_trail(tmp_path)
    edited(made)
    found = ask("verify", str(made.paths.folder), language=language)
    assert found.exit_code == 1
    assert ("audit.jsonl line 5" if language == "en" else "audit.jsonl 第 5 行") in found.output
    message = json.loads(ask("verify", str(made.paths.folder), "--json").stdout)
    assert (message["ok"], [(one["kind"], one["line"]) for one in message["problems"]]) == (False, [("changed", 5)])


def test_without_the_key_the_report_says_that_checkpoints_prove_less(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    made.paths.key.rename(tmp_path / "elsewhere.key")
    found = ask("verify", str(made.paths.folder))
    assert (found.exit_code, "no key" in found.output) == (0, True)
    again = ask("verify", str(made.paths.folder), "--key", str(tmp_path / "elsewhere.key"))
    assert (again.exit_code, "no key" in again.output) == (0, False)


def test_checkpoints_may_lie_elsewhere(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    marks = tmp_path / "marks.jsonl"
    made.paths.checkpoints.rename(marks)
    assert ask("verify", str(made.paths.folder)).exit_code == 1
    assert ask("verify", str(made.paths.folder), "--checkpoints", str(marks)).exit_code == 0


def test_the_plant_file_names_checkpoints_and_key(tmp_path: Path) -> None:
    """A cut is found by the checkpoints that ``[audit]`` puts elsewhere, without naming them again."""
    made = written_trail(tmp_path)
    file = tmp_path / "plant.toml"
    head = f'format = 1\n[plant]\nid = "p"\ndirectory = "{made.paths.folder}"\n'
    audit = '[audit]\ncheckpoints = "marks"\nkey = "k"\n'
    file.write_text(
        head + audit + '[bus.a]\nlink = "sim://c320@1"\n[drive.f]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
    )
    made.paths.checkpoints.rename(tmp_path / "marks")
    made.paths.key.rename(tmp_path / "k")
    found = ask("verify", str(file))
    assert (found.exit_code, "no key" in found.output, "record 10" in found.output) == (0, False, True)
    kept = made.paths.current.read_bytes().splitlines(keepends=True)
    made.paths.current.write_bytes(b"".join(kept[:-2]))
    assert ask("verify", str(file)).exit_code == 1


def test_the_only_plant_of_a_user_needs_no_name(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    plants = tmp_path / "drivebus" / "plants"
    plants.mkdir(parents=True)
    env = {"XDG_STATE_HOME": str(tmp_path)}
    assert ask("verify", env=env).exit_code == 2
    made.paths.folder.rename(plants / "hall")
    made.paths.key.rename(plants / "hall.audit.key")
    assert ask("verify", env=env).exit_code == 0
    (plants / "mill").mkdir()
    assert "hall, mill" in ask("verify", env=env).output


def test_what_is_no_trail_or_can_not_be_read_is_the_users_to_mend(tmp_path: Path) -> None:
    assert ask("verify", str(tmp_path / "nowhere")).exit_code == 2
    (tmp_path / "audit.jsonl").mkdir()
    assert ask("verify", str(tmp_path)).exit_code == 2


def test_the_list_shows_escapes_as_escapes(tmp_path: Path) -> None:
    async def go() -> AuditTrail:
        made = new_trail(tmp_path)
        await made.open()
        await made.record(AuditEntry.by(LI, "login", target="x\x1b[31m\r\n\u202e\u0085y 风机", outcome="refused"))
        await made.record(AuditEntry.by(LI, "drive.stop", target="fan-1", outcome="confirmed"))
        await made.close()
        return made

    folder = str(asyncio.run(go()).paths.folder)
    found = ask("list", folder)
    assert found.exit_code == 0
    assert "x\\x1b[31m\\r\\n\\u202e\\x85y 风机" in found.output
    assert not any(bad in found.output for bad in ("\x1b", "\r", "\u202e", "\u0085"))
    assert len(found.output.splitlines()) == 1 + 3
    only = json.loads(ask("list", folder, "--drive", "fan-1", "--json").stdout)["items"]
    assert [(one["what"], one["n"]) for one in only] == [("drive.stop", 3)]
    assert len(json.loads(ask("list", folder, "--limit", "1", "--json").stdout)["items"]) == 1
