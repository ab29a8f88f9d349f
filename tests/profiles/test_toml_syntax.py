"""Faults of the TOML syntax, in the words of the user's language."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from drivebus.cli.main import cli
from drivebus.profiles.diagnostics import to_diagnostic
from drivebus.profiles.toml_file import TomlFault, decode_toml


def fault_texts(text: str) -> tuple[str, str]:
    """Return the English and the Chinese sentence of the fault of a text."""
    with pytest.raises(TomlFault) as caught:
        decode_toml(text.encode())
    diagnostic = to_diagnostic(caught.value.issue, "a.toml", caught.value.line)
    return diagnostic.text("en"), diagnostic.text("zh")


FAULTS = [
    ("a 1", "a.toml:1", "= after the key (column 3)", "键后面的 =（第 3 列）"),
    ("\na = b", "a.toml:2", "or a text in quotes (column 5)", "或引号中的文本（第 5 列）"),
    ("泵 = 1", "a.toml:1", "any other key in quotes", "加引号的其他键"),
    ("a = 1 2", "a.toml:1", "the end of the line after the value", "值之后换行"),
    ("a.= 1", "a.toml:1", "letters, digits, _ and -", "由字母、数字、_ 和 - 组成的键"),
    ("a = 1\na = 2", "a.toml:2", "each key once in its table", "同一表中每个键只出现一次"),
    ("a = {b = 1, b = 2}", "a.toml:1", "each key once in its table", "同一表中每个键只出现一次"),
    ("[a]\n[a]", "a.toml:2", "each table once", "每个表只出现一次"),
    ("a = {}\na.b = 1", "a.toml:2", "each table once", "每个表只出现一次"),
    ("[a", "a.toml:1", "] at the end of the name of the table (column 3)", "表名末尾的 ]（第 3 列）"),
    ("[[a]", "a.toml:1", "]] at the end of the name", "表名末尾的 ]]"),
    ("a = [1 2]", "a.toml:1", "a comma or the ] of the list", "逗号或列表末尾的 ]"),
    ("a = {b = 1 c", "a.toml:1", "a comma or the } of the table", "逗号或表末尾的 }"),
    ('a = "x\nb = 1', "a.toml:1", "the closing quote of the text (column 7)", "文本末尾的引号（第 7 列）"),
    ('a = "C:\\dir"', "a.toml:1", "\\\\ for a backslash", "反斜杠写作 \\\\"),
    ('a = "\x01"', "a.toml:1", "no control character", "不含控制字符"),
    ("a = 2026-02-30", "a.toml:1", "a date that exists", "存在的日期"),
    (
        't = "' + "9" * 30 + '"\na = ' + "9" * 5_000,
        "a.toml:2",
        "a number with fewer digits (column 5)",
        "位数更少的数字",
    ),
    (
        "a = [1, 0x" + "F" * 5_000 + "]",
        "a.toml:1",
        "a number with fewer digits (column 9)",
        "位数更少的数字（第 9 列）",
    ),
    ("a = -" + "9" * 20, "a.toml:1", "a number with fewer digits", "位数更少的数字"),
    ("a = " + "[" * 50_000, "a.toml:1", "fewer brackets", "更少的括号"),
]


@pytest.mark.parametrize(("text", "place", "english", "chinese"), FAULTS, ids=[row[2] for row in FAULTS])
def test_a_syntax_fault_is_named_in_both_languages_with_line_and_column(
    text: str, place: str, english: str, chinese: str
) -> None:
    """The English message of tomllib stood within the Chinese sentence."""
    in_english, in_chinese = fault_texts(text)
    assert place in in_english and english in in_english, in_english
    assert place in in_chinese and chinese in in_chinese, in_chinese
    assert "Expected" not in in_chinese and "Invalid" not in in_chinese and "Cannot" not in in_chinese


def test_an_unknown_message_of_the_parser_is_marked_as_its_own_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.profiles.toml_file._SYNTAX_FAULTS", ())
    english, chinese = fault_texts("a 1")
    assert "the parser's own words: Expected '='" in english and "解析器原文：Expected '='" in chinese


def test_a_fault_of_the_syntax_does_not_show_the_value_which_may_be_a_password() -> None:
    for text in ('password = "secret\n', "password 'secret'\n", 'password = "secret" x\n', 'password = "secret”\n'):
        assert not any("secret" in sentence for sentence in fault_texts(text))
    for between in ("\t", ":", ": ", ""):
        assert all(
            "password" in sentence and "secret" not in sentence
            for sentence in fault_texts(f'password{between}"secret"\n')
        )


@pytest.mark.parametrize(
    ("text", "full", "half"),
    [("a＝1", "＝", "="), ("a = “x”", "“", '"'), ("[a】", "】", "]"), ("a = １", "１", "1"), ("a = [1，2]", "，", ",")],
)
def test_a_full_width_sign_outside_a_text_is_named_with_the_half_width_one(text: str, full: str, half: str) -> None:
    english, chinese = fault_texts(text)
    assert f'"{full}" found, the half-width {half} (column' in english
    assert f'实际为 "{full}"，应为半角 {half}（第' in chinese


def test_a_full_width_sign_within_a_text_or_a_comment_is_not_the_fault() -> None:
    assert "full-width" not in fault_texts('a = "风机（１）" 7 # 注：')[0]


UNCLOSED = ['a = "风机，一号\nb = 1', "a = '水泵（1）", 'a = "水泵" # 备\nb = """启动，\n停止（2）']


@pytest.mark.parametrize("text", UNCLOSED)
def test_a_full_width_sign_of_a_text_without_its_closing_quote_is_not_the_fault(text: str) -> None:
    """The comma was named, and behind it the missing quote of the same line."""
    assert "the closing quote of the text" in fault_texts(text)[0]


def test_a_full_width_sign_behind_the_fault_of_its_line_is_not_named() -> None:
    """The comma was named; the quotes within the text end it."""
    text = fault_texts('a = "风机"一号，二号"')[0]
    assert "the end of the line after the value" in text and "full-width" not in text


def test_a_full_width_space_is_called_a_space_as_a_blank_is_not_seen() -> None:
    english, chinese = fault_texts("a　= 1")
    assert "the half-width space (column 2)" in english and "应为半角空格（第 2 列）" in chinese


def test_a_full_width_quote_at_the_end_of_a_text_is_named_rather_than_a_sign_before_it() -> None:
    assert '"”" found, the half-width "' in fault_texts('a = "风机，一号”\n')[0]


@pytest.mark.parametrize(
    ("words", "name"),
    [(["check", "{file}"], "plant.toml"), (["init", "--answers", "{file}"], "a"), (["profile", "new", "x.toml"], "b")],
)
def test_every_command_that_reads_a_toml_file_tells_its_fault_in_chinese(
    words: list[str], name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """``profile new --answers`` printed the message of the parser as it was."""
    file = tmp_path_factory.mktemp("faulty") / f"{name}.toml"
    file.write_text("title = 1\nformat 1\n")
    words = [word.format(file=file) for word in words] + (["--answers", str(file)] if name == "b" else [])
    result = CliRunner().invoke(cli, [*words, "--lang", "zh"])
    assert result.exit_code == 2
    assert "键后面的 =（第 8 列）" in result.output.replace("\n", "") and "Expected" not in result.output, result.output
