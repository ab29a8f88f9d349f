"""Command ``drivebus audit``: reports about the trail."""

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


def invoke_audit(*words: str, language: str = "en", env: dict[str, str] | None = None) -> Result:
    return CliRunner().invoke(cli, ["audit", *words, "--lang", language], env=env)


def edit_record(trail: AuditTrail) -> None:
    trail.paths.current.write_bytes(trail.paths.current.read_bytes().replace(*EDIT))


def test_an_unchanged_trail_is_verified(tmp_path: Path) -> None:
    found = invoke_audit("verify", str(written_trail(tmp_path).paths.folder))
    assert found.exit_code == 0
    assert "Complete and unchanged: records 10" in found.output and "record 10" in found.output


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_edit_is_reported_with_its_file_and_line(tmp_path: Path, language: str) -> None:
    trail = written_trail(tmp_path)
    edit_record(trail)
    found = invoke_audit("verify", str(trail.paths.folder), language=language)
    assert found.exit_code == 1
    assert ("audit.jsonl line 5" if language == "en" else "audit.jsonl 第 5 行") in found.output
    report = json.loads(invoke_audit("verify", str(trail.paths.folder), "--json").stdout)
    assert (report["ok"], [(problem["kind"], problem["line"]) for problem in report["problems"]]) == (
        False,
        [("changed", 5)],
    )


def test_a_missing_key_is_reported(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.key.rename(tmp_path / "elsewhere.key")
    found = invoke_audit("verify", str(trail.paths.folder))
    assert (found.exit_code, "no key" in found.output) == (0, True)
    again = invoke_audit("verify", str(trail.paths.folder), "--key", str(tmp_path / "elsewhere.key"))
    assert (again.exit_code, "no key" in again.output) == (0, False)


def test_a_trail_without_head_is_compared_with_a_number_from_the_log(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    assert "newest checkpoints" not in invoke_audit("verify", str(trail.paths.folder)).output
    trail.paths.head.rename(tmp_path / "head")
    found = invoke_audit("verify", str(trail.paths.folder), "--at-least", "10")
    assert (found.exit_code, "newest checkpoints" in found.output) == (0, True)
    found = invoke_audit("verify", str(trail.paths.folder), "--at-least", "11", "--head", str(tmp_path / "head"))
    assert (found.exit_code, "at least 11" in found.output, "newest checkpoints" in found.output) == (1, True, False)


def test_a_head_that_was_changed_is_not_reported_as_absent(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.head.write_text("{}")
    found = invoke_audit("verify", str(trail.paths.folder))
    assert (found.exit_code, "not a checkpoint" in found.output, "There is no" in found.output) == (1, True, False)


def test_the_checkpoint_file_can_be_given(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    checkpoints = tmp_path / "checkpoints.jsonl"
    trail.paths.checkpoints.rename(checkpoints)
    assert invoke_audit("verify", str(trail.paths.folder)).exit_code == 1
    assert invoke_audit("verify", str(trail.paths.folder), "--checkpoints", str(checkpoints)).exit_code == 0


def test_the_plant_file_names_checkpoints_and_key(tmp_path: Path) -> None:
    """A cut is found by the checkpoints that ``[audit]`` puts elsewhere, without naming them again."""
    trail = written_trail(tmp_path)
    file = tmp_path / "plant.toml"
    head = f'format = 1\n[plant]\nid = "p"\ndirectory = "{trail.paths.folder}"\n'
    audit = '[audit]\ncheckpoints = "marks"\nkey = "k"\n'
    file.write_text(
        head + audit + '[bus.a]\nport = "sim://c320@1"\n[drive.f]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
    )
    trail.paths.checkpoints.rename(tmp_path / "marks")
    trail.paths.key.rename(tmp_path / "k")
    found = invoke_audit("verify", str(file))
    assert (found.exit_code, "no key" in found.output, "record 10" in found.output) == (0, False, True)
    records = trail.paths.current.read_bytes().splitlines(keepends=True)
    trail.paths.current.write_bytes(b"".join(records[:-2]))
    assert invoke_audit("verify", str(file)).exit_code == 1


def test_the_only_plant_of_a_user_needs_no_name(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    plants = tmp_path / "drivebus" / "plants"
    plants.mkdir(parents=True)
    env = {"XDG_STATE_HOME": str(tmp_path)}
    assert invoke_audit("verify", env=env).exit_code == 2
    trail.paths.folder.rename(plants / "hall")
    trail.paths.key.rename(plants / "hall.audit.key")
    assert invoke_audit("verify", env=env).exit_code == 0
    (plants / "mill").mkdir()
    assert "hall, mill" in invoke_audit("verify", env=env).output


def test_what_is_no_trail_or_can_not_be_read_is_the_users_to_mend(tmp_path: Path) -> None:
    assert invoke_audit("verify", str(tmp_path / "nowhere")).exit_code == 2
    (tmp_path / "audit.jsonl").mkdir()
    assert invoke_audit("verify", str(tmp_path)).exit_code == 2


def test_the_list_shows_escapes_as_escapes(tmp_path: Path) -> None:
    async def go() -> AuditTrail:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(AuditEntry.by(LI, "login", target="x\x1b[31m\r\n\u202e\u0085y 风机", outcome="refused"))
        await trail.record(AuditEntry.by(LI, "drive.stop", target="fan-1", outcome="confirmed"))
        await trail.close()
        return trail

    folder = str(asyncio.run(go()).paths.folder)
    found = invoke_audit("list", folder)
    assert found.exit_code == 0
    assert "x\\x1b[31m\\r\\n\\u202e\\x85y 风机" in found.output
    assert not any(bad in found.output for bad in ("\x1b", "\r", "\u202e", "\u0085"))
    assert len(found.output.splitlines()) == 1 + 3
    only = json.loads(invoke_audit("list", folder, "--drive", "fan-1", "--json").stdout)["items"]
    assert [(record["what"], record["n"]) for record in only] == [("drive.stop", 3)]
    assert len(json.loads(invoke_audit("list", folder, "--limit", "1", "--json").stdout)["items"]) == 1


@pytest.mark.parametrize(
    ("language", "words"),
    [("en", "Run fan-1: 4.0 Hz"), ("zh", "运行 fan-1：4.0 Hz")],
)
def test_the_list_shows_actions_in_words_with_their_values(tmp_path: Path, language: str, words: str) -> None:
    folder = str(written_trail(tmp_path).paths.folder)
    shown = invoke_audit("list", folder, language=language).output
    assert words in shown and "drive.run" not in shown
    record = json.loads(invoke_audit("list", folder, "--json").stdout)["items"][-4]
    assert (record["what"], record["text"]["en"]) == ("drive.run", "Run fan-1: 4.0 Hz")


def test_the_list_of_a_plant_file_shows_the_titles_of_its_drives(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    file = tmp_path / "plant.toml"
    file.write_text(
        f'format = 1\n[plant]\nid = "p"\ndirectory = "{trail.paths.folder}"\n[bus.a]\nport = "sim://c320@1"\n'
        '[drive.fan-1]\nbus = "a"\naddress = 1\nmodel = "c320"\ntitle = { en = "Supply fan", zh = "送风机" }\n'
    )
    assert "运行送风机：4.0 Hz" in invoke_audit("list", str(file), language="zh").output
