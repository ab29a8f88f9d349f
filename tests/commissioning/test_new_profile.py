"""A profile written from the facts of a manual: answers, register table, file, trial on a simulated drive."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from drivebus import profiles
from drivebus.cli.main import cli
from drivebus.commissioning.new_profile.file_text import profile_toml
from drivebus.commissioning.new_profile.questions import QUESTIONS, UNKNOWN, fact, open_questions, parse_word
from drivebus.commissioning.new_profile.register_table import read_table
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.commissioning.profile_trial import try_profile
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import LimitError, ProfileError
from drivebus.profiles import grades
from drivebus.profiles.model import UNDETERMINED
from drivebus.testing import virtual_time
from fixtures.manual_answers import ANSWERS

BITS = {"status_kind": "bits", "running_bit": "0", "reverse_bit": "3", "fault_bit": "7"}
SHARE = {"setpoint_kind": "share", "full_scale": "10000", "factory_maximum": "50", "highest_maximum": "400"}


def written(tmp_path: Path, changed: dict[str, str], language: str = "en", rows: Any = ()) -> profiles.DriveProfile:
    path = tmp_path / "acme_v1.toml"
    path.write_text(profile_toml(ANSWERS | changed, rows, language), encoding="utf-8")
    return profiles.load(path)


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("changed", [{}, BITS, SHARE, {"write_function": "16", "encoding": "ascii"}])
def test_the_file_of_complete_answers_is_valid_and_every_command_works(
    tmp_path: Path, changed: dict[str, str], language: str
) -> None:
    profile = written(tmp_path, changed, language)
    assert profile.grade == "draft" and profile.addresses == (1, 31) and profile.serial.baud == 19200
    assert profile.commands is not None and profile.commands.values["stop"] == 0x12
    steps = virtual_time.run(try_profile(profile))
    assert [step.name for step in steps] == ["status", "start", "setpoint", "stop", "reverse", "stop", "reset"]
    assert [step.error for step in steps] == [None] * 7
    assert all(step.frames for step in steps)


def test_a_trial_ends_at_the_step_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    profile = written(tmp_path, {})
    monkeypatch.setattr(ProfileStation, "_store", lambda station, changes: 4)
    steps = virtual_time.run(try_profile(profile))
    assert [step.name for step in steps] == ["status", "start"]
    assert steps[0].error is None and steps[1].error is not None


def test_a_fact_that_the_manual_lacks_is_an_open_question_and_no_capability(tmp_path: Path) -> None:
    gone = {"status_register": UNKNOWN, "start_reverse": UNKNOWN, "reset": UNKNOWN}
    profile = written(tmp_path, gone)
    assert not {"reverse", "reset_fault", "status", "coast"} & profile.capabilities
    assert {"status_register", "start_reverse", "reset", "coast", "max_read"} <= {
        q.name for q in profile.open_questions
    }
    assert profile.status is None


@pytest.mark.parametrize(
    ("changed", "standstill"),
    [
        ({}, "output_frequency"),
        ({"runs_to_standstill": "no"}, "output_frequency"),
        ({"runs_to_standstill": "yes"}, "status"),
        ({"frequency_register": UNKNOWN}, "status"),
    ],
)
def test_a_stop_is_confirmed_at_0_hz_unless_the_manual_says_that_the_state_shows_it(
    tmp_path: Path, changed: dict[str, str], standstill: str
) -> None:
    profile = written(tmp_path, changed)
    assert profile.status is not None and profile.status.standstill == standstill
    steps = virtual_time.run(try_profile(profile))
    assert [step.error for step in steps] == [None] * len(steps)


@pytest.mark.parametrize("word", ["10", "2000", "1x", "12345H", "-1", "0x", "70000d", ""])
def test_a_word_of_several_digits_without_its_base_is_rejected(word: str) -> None:
    """10 may be 10 or 16; as a command word the two may be a stop and a start."""
    with pytest.raises(ValueError, match=r".*"):
        parse_word(word)


@pytest.mark.parametrize(
    ("numbering", "text", "register"),
    [
        ("hex", "2000", 0x2000),
        ("decimal", "8192", 0x2000),
        ("40001", "48193", 0x2000),
        ("one", "8193", 0x2000),
        ("one", "2000H", 0x2000),
    ],
)
def test_a_register_is_read_as_the_manual_numbers_it(numbering: str, text: str, register: int) -> None:
    assert fact({"numbering": numbering, "command_register": text}, "command_register") == register


def test_a_question_that_another_answer_makes_needless_is_not_asked() -> None:
    asked = [question.name for question in open_questions({"status_register": UNKNOWN, "setpoint_kind": "step"})]
    assert not {"status_kind", "running_bit", "value_stopped", "fault_register", "full_scale"} & {*asked}
    assert "setpoint_step" in asked


# --- register table ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "gb18030"])
def test_a_register_table_becomes_signals_and_parameters(tmp_path: Path, encoding: str) -> None:
    table = tmp_path / "table.csv"
    table.write_text(
        "名称;地址;单位;倍率;读写;说明\n母线电压;2105;V;0.1;只读;直流\nP0.02;F002;;;读写;命令源\n", encoding=encoding
    )
    rows = read_table(table, "hex")
    profile = written(tmp_path, {}, "zh", rows)
    signal = profile.signals["register_2105"]
    assert signal.locator[1] == 0x2105 and signal.unit == "V" and signal.scale.factor == 0.1
    assert profile.parameters["P0.02"].locator[1] == 0xF002


def test_each_faulty_line_of_a_table_is_named_with_its_field(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    lines = ["name,address,unit,scale,access", "a,2100,Hz,0.01,r", "b,zz,,,", "c,2100,,,", "a,2101,,,", ",2102,,,"]
    lines += ["d,2103,bar,,", "e,2104,,0,", "f,2105,,,maybe"]
    table.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        read_table(table, "hex")
    found = [(diagnostic.line, diagnostic.key, diagnostic.kind) for diagnostic in caught.value.params["diagnostics"]]
    assert found == [
        (3, "address", "address"),
        (4, "address", "address_again"),
        (5, "name", "name_again"),
        (6, "name", "no_name"),
        (7, "unit", "unit"),
        (8, "scale", "scale"),
        (9, "access", "access"),
    ]
    assert all(diagnostic.expected.en and diagnostic.remedy.zh for diagnostic in caught.value.params["diagnostics"])


@pytest.mark.parametrize(("text", "kind"), [("", "empty"), ("unit,text\nHz,x\n", "header")])
def test_a_table_without_header_is_rejected(tmp_path: Path, text: str, kind: str) -> None:
    table = tmp_path / "table.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        read_table(table, "hex")
    assert [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]] == [kind]


# --- command line ------------------------------------------------------------------------------------------------


def invoke(*arguments: str, answers: dict[str, str] | None = None) -> Any:
    lines = "".join(f"{text}\n" for text in (answers or {}).values())
    return CliRunner().invoke(cli, ["profile", "new", *arguments], input=lines)


def test_a_dialogue_writes_checks_and_tries_the_profile(tmp_path: Path) -> None:
    file = tmp_path / "acme.toml"
    result = invoke(str(file), answers=ANSWERS)
    assert result.exit_code == 0, result.output
    assert profiles.load(file).model == "acme_v1"
    assert "start forward, 10 Hz: ok" in result.output and "06 20 00 00 01" in result.output
    assert "Uncouple the motor" in result.output and "P0.02 = 2" in result.output


def test_a_wrong_answer_is_asked_for_again(tmp_path: Path) -> None:
    file = tmp_path / "acme.toml"
    lines = [*ANSWERS.values()]
    at = [*ANSWERS].index("stop")
    result = CliRunner().invoke(
        cli, ["profile", "new", str(file)], input="\n".join([*lines[:at], "12", *lines[at:]]) + "\n"
    )
    assert result.exit_code == 0 and "12: expected one digit, or a word with its base" in result.output


def test_full_width_answers_are_read_as_half_width_ones_and_texts_stay(tmp_path: Path) -> None:
    """A Chinese input method types them: each was refused without the reason."""
    wide = {ord(half): ord(half) + 0xFEE0 for half in map(chr, range(0x21, 0x7F))}
    texts = {question.name for question in QUESTIONS if question.kind == "text"}
    typed = {
        name: text if name in texts and text != UNKNOWN else text.translate(wide) for name, text in ANSWERS.items()
    }
    file = tmp_path / "acme.toml"
    result = invoke(str(file), answers=typed | {"maker": "艾美（１）"})
    assert result.exit_code == 0, result.output
    assert (profiles.load(file).model, profiles.load(file).maker.zh) == ("acme_v1", "艾美（１）")


def test_an_unfinished_dialogue_is_continued(tmp_path: Path) -> None:
    file, kept = tmp_path / "acme.toml", tmp_path / "acme.toml.answers.toml"
    first = dict([*ANSWERS.items()][:20])
    result = invoke(str(file), answers=first)
    assert result.exit_code == 130 and not file.exists()
    assert tomllib.loads(kept.read_text(encoding="utf-8")) == first
    rest = {name: text for name, text in ANSWERS.items() if name not in first}
    assert invoke(str(file), "--answers", str(kept), answers=rest).exit_code == 0
    assert profiles.load(file).model == "acme_v1"


def test_a_kept_answer_that_is_no_answer_is_named(tmp_path: Path) -> None:
    kept = tmp_path / "kept.toml"
    kept.write_text('baud = "fast"\n', encoding="utf-8")
    result = invoke(str(tmp_path / "a.toml"), "--answers", str(kept))
    assert result.exit_code == 2 and "baud: fast found; expected a number from 300" in " ".join(result.output.split())
    kept.write_text('bauds = "9600"\n', encoding="utf-8")
    assert invoke(str(tmp_path / "a.toml"), "--answers", str(kept)).exit_code == 2


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "acme.toml"
    file.write_text("mine", encoding="utf-8")
    assert invoke(str(file), answers=ANSWERS).exit_code == 2
    assert file.read_text(encoding="utf-8") == "mine"
    assert invoke(str(file), "--force", answers=ANSWERS).exit_code == 0


NO_NEIGHBOURS = {"loopback": "no", "frequency_register": "2200", "fault_register": UNKNOWN}
"""Without loop-back and with no neighbouring registers a late reply can't be recognized."""


def inserted_after(answers: dict[str, str], name: str, added: dict[str, str]) -> dict[str, str]:
    """Return answers in their order with those of further questions behind one of them."""
    at = [*answers].index(name) + 1
    items = [*answers.items()]
    return dict([*items[:at], *((key, text) for key, text in added.items() if key not in answers), *items[at:]])


def with_neighbour(*texts: str, **changed: str) -> str:
    """Return the input of a dialogue with these answers to the question for a neighbouring register."""
    answers = ANSWERS | NO_NEIGHBOURS | changed
    if answers["status_register"] == UNKNOWN:
        left_out = {*STATUS_QUESTIONS, "runs_to_standstill"}
        answers = {name: text for name, text in answers.items() if name not in left_out}
    if answers["frequency_register"] == UNKNOWN:
        answers = {name: text for name, text in answers.items() if name not in ("frequency_step", "runs_to_standstill")}
    answers.pop("fault_coding", None)
    if answers["loopback"] != "yes":
        answers = inserted_after(answers, "loopback", {"rejected_read": UNKNOWN} | changed)
    names = [*answers]
    at = names.index("readings_page")
    lines = [*answers.values()]
    return "\n".join([*lines[:at], *texts, *lines[at:]]) + "\n"


STATUS_QUESTIONS = [question.name for question in QUESTIONS if question.name.startswith(("value_", "status_kind"))]
STATUS_QUESTIONS += ["fault_register", "status_page"]


@pytest.mark.parametrize(
    ("texts", "changed", "registers"),
    [
        (("2201",), {}, [0x2201]),
        (("20FF",), {}, [0x20FF]),
        (("3000",), {"status_register": UNKNOWN, "frequency_register": UNKNOWN}, [0x3000, 0x3001]),
    ],
)
def test_a_register_beside_a_known_one_is_asked_for_where_nothing_else_recognizes_a_late_reply(
    tmp_path: Path, texts: tuple[str, ...], changed: dict[str, str], registers: list[int]
) -> None:
    """The file was not valid yet, and no question led out of that."""
    file = tmp_path / "acme.toml"
    given = with_neighbour(*texts, **changed)
    result = CliRunner().invoke(cli, ["profile", "new", str(file), "--lang", "en"], input=given)
    assert result.exit_code == 0, result.output
    signals = {signal.locator[1] for signal in profiles.load(file).signals.values()}
    assert {*registers} <= signals


def test_a_register_that_is_no_neighbour_or_a_command_is_asked_for_again(tmp_path: Path) -> None:
    file = tmp_path / "acme.toml"
    given = with_neighbour("2300", "2200", "2201")
    result = CliRunner().invoke(cli, ["profile", "new", str(file), "--lang", "en"], input=given)
    assert result.exit_code == 0, result.output
    shown = " ".join(result.output.split())
    assert shown.count("directly before or after one of: 2100H, 2200H") == 2


@pytest.mark.parametrize(("loopback", "frequency"), [("yes", "2200"), ("no", "2101")])
def test_no_neighbour_is_asked_for_where_a_late_reply_can_be_recognized(loopback: str, frequency: str) -> None:
    answers = {**ANSWERS, "loopback": loopback, "frequency_register": frequency}
    assert "neighbour_register" not in [question.name for question in open_questions(answers)]


def test_a_step_that_the_manual_lacks_is_assumed_and_never_recorded_as_its_evidence(tmp_path: Path) -> None:
    """Enter took 0.01 Hz, with the manual as its evidence, and ? was refused."""
    steps = [question for question in QUESTIONS if question.name.endswith("_step")]
    assert len(steps) == 3 and all(step.default is None and step.accepts_unknown for step in steps)
    profile = written(tmp_path, {"setpoint_step": UNKNOWN})
    assert profile.evidence["setpoint"].kind == "assumed"
    assert profile.setpoint_scale.factor == 0.1, "of the usual steps the one that gives the lower word"
    assert profile.options["setpoint_step"] == UNDETERMINED and "setpoint_step" in {
        q.name for q in profile.open_questions
    }
    with pytest.raises(LimitError):
        create_dialect(profile, 1).setpoint_word(5.1)
    steps = virtual_time.run(try_profile(profile))
    assert [step.error for step in steps] == [None] * 7, "the simulated drive counts the assumed step"
    assert written(tmp_path, {"setpoint_step": "0.01"}).evidence["setpoint"].kind == "manual"
    signal = written(tmp_path, {"frequency_step": UNKNOWN}).signals["output_frequency"]
    assert signal.uncertain == "profiles.scale_unpublished" and signal.unit == ""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_every_command_of_the_checklist_parses(tmp_path: Path, language: str) -> None:
    """Step 6 had an option that does not exist."""
    answers = ANSWERS | {"keypad": "K"}
    given = "".join(f"{text}\n" for text in answers.values())
    file = tmp_path / "acme.toml"
    shown = CliRunner().invoke(cli, ["profile", "new", str(file), "--lang", language], input=given).output
    lines = re.findall(r"drivebus ((?:status|set-frequency|run) PORT[^,:，：。\n]*?)(?=[,:，：。]|\n)", shown)
    assert [line.split()[0] for line in lines] == ["status", "set-frequency", "run"]
    for line in lines:
        words = line.partition(". ")[0].replace("PORT", "sim://vc660@1").replace("address N", "address 1").split()
        command = cli.get_command(click.Context(cli), words[0])
        assert command is not None
        command.make_context(words[0], words[1:])


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"setpoint_step": UNKNOWN}, "drivebus calibrate PORT --model"),
        (SHARE, "--option maximum_frequency=HZ"),
        ({}, None),
    ],
)
def test_the_checklist_names_what_the_cap_of_5_hz_waits_for(
    tmp_path: Path, changed: dict[str, str], named: str | None
) -> None:
    answers = {}
    for name, text in (ANSWERS | changed).items():
        if name != "setpoint_step" or "full_scale" not in changed:
            answers[name] = text
        if name == "setpoint_kind":
            answers |= {key: changed[key] for key in SHARE if key in changed}
    result = invoke(str(tmp_path / "acme.toml"), "--lang", "en", answers=answers)
    assert result.exit_code == 0, result.output
    assert ("5 Hz is the most" in result.output) == (named is not None)
    assert named is None or named in result.output


@pytest.mark.parametrize(
    ("changed", "added"),
    [
        ({"max_read": "1", "loopback": "no"}, {"rejected_read": "2"}),
        ({"max_read": "4", "loopback": "no", **NO_NEIGHBOURS}, {"rejected_read": "5"}),
        ({"reply_count_bytes": "2"}, {}),
    ],
)
def test_a_drive_with_replies_of_its_own_gets_a_whole_profile(
    tmp_path: Path, changed: dict[str, str], added: dict[str, str]
) -> None:
    """The format had both keys and no question led to them: such a dialogue ended in a file that is not valid."""
    answers = ANSWERS | changed
    if answers["fault_register"] == UNKNOWN:
        answers.pop("fault_coding")
    file = tmp_path / "acme.toml"
    result = invoke(str(file), "--lang", "en", answers=inserted_after(answers, "loopback", added))
    assert result.exit_code == 0, result.output
    modbus = profiles.load(file).modbus
    assert modbus is not None and modbus.reply_count_bytes == int(answers["reply_count_bytes"])
    assert modbus.rejected_read == (int(added["rejected_read"]) if added else None)


@pytest.mark.parametrize(("max_read", "rejected"), [("4", "4"), (UNKNOWN, "2"), ("4", "126"), ("4", "4.5"), ("4", "x")])
def test_a_read_that_the_drive_allows_is_no_rejected_one(tmp_path: Path, max_read: str, rejected: str) -> None:
    answers = inserted_after(
        ANSWERS | {"loopback": "no", "max_read": max_read}, "loopback", {"rejected_read": rejected}
    )
    shown = " ".join(invoke(str(tmp_path / "acme.toml"), "--lang", "en", answers=answers).output.split())
    assert f"{rejected}: expected a whole number above" in shown


@pytest.mark.parametrize(
    ("answers", "asked"),
    [
        ({"encoding": "rtu", "loopback": "no"}, {"reply_count_bytes", "rejected_read"}),
        ({"encoding": "rtu", "loopback": "yes"}, {"reply_count_bytes"}),
        ({"encoding": "ascii", "loopback": "no"}, set()),
    ],
)
def test_replies_that_deviate_are_asked_for_where_a_profile_may_have_them(
    answers: dict[str, str], asked: set[str]
) -> None:
    names = {question.name for question in open_questions(answers)}
    assert names & {"reply_count_bytes", "rejected_read"} == asked


def test_a_file_that_is_not_valid_yet_is_kept_and_says_why(tmp_path: Path) -> None:
    file = tmp_path / "acme.toml"
    given = with_neighbour(UNKNOWN)
    result = CliRunner().invoke(cli, ["profile", "new", str(file)], input=given)
    assert result.exit_code == 2 and file.exists()
    assert "no way to distinguish a late reply" in " ".join(result.output.split())


def test_every_question_has_its_texts_and_a_name_of_its_own() -> None:
    assert len({question.name for question in QUESTIONS}) == len(QUESTIONS)


# --- what a grade lacks --------------------------------------------------------------------------------------------


def test_a_draft_lacks_frames_a_station_and_a_second_source(tmp_path: Path) -> None:
    profile = written(tmp_path, {})
    found = grades.open_requirements(profile)
    assert [lack.kind for lack in found] == ["vectors", "station", "second_source", "assumed", "questions"]
    assumed, questions = grades.open_requirements(profile)[3:]
    assert "timing" in assumed.params["names"] and "commands" not in assumed.params["names"]
    assert questions.params["count"] == len(profile.open_questions)


def test_a_simulated_model_lacks_a_real_drive() -> None:
    assert grades.open_requirements(profiles.load("vc660"))[0].kind == "hardware"
    assert grades.next_grade(profiles.load("vc660")) == "verified"
