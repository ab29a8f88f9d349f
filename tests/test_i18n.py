"""The catalogues: the same keys and placeholders in every language, no shared and no unused keys."""

from __future__ import annotations

import ast
import io
import json
import re
import string
from collections.abc import Iterator
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from drivebus import errors, i18n, profiles
from drivebus.drives.context import UnmetPrecondition
from drivebus.drives.operations.preflight import keypad_steps
from drivebus.drives.state import DriveState
from drivebus.protocols.family import protocol_families
from drivebus.service.api.operations import OPERATIONS
from drivebus.service.auth.rights import Right
from drivebus.service.config.model import InterlockConfig
from drivebus.service.interlocks.engine import InterlockEngine
from drivebus.values import Text
from drivebus.web.operations import WEB_OPERATIONS

SOURCE = Path(i18n.__file__).parents[1]
FOLDERS = (Path(i18n.__file__).parent, *sorted((SOURCE / "families").glob("*/texts")))
CATALOGUES = {path.name.split(".")[0]: folder for folder in FOLDERS for path in folder.glob("*.json")}
NAMES = sorted(CATALOGUES)
protocol_families()  # adds the texts of the families
FILES = {"db", "json", "jsonl", "lock", "sock", "toml"}
KEY = re.compile(r"[a-z][a-z0-9_]*(?:\.[a-z0-9][a-z0-9_]*)+")


def read_catalogue(catalogue: str, language: str) -> dict[str, str]:
    """Return a catalogue; fail if a key occurs twice in the file."""
    pairs: list[tuple[str, str]] = json.loads(
        (CATALOGUES[catalogue] / f"{catalogue}.{language}.json").read_text(encoding="utf-8"), object_pairs_hook=list
    )
    keys = [key for key, _ in pairs]
    assert len(keys) == len(set(keys)), {key for key in keys if keys.count(key) > 1}
    return dict(pairs)


def placeholders(sentence: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(sentence) if name is not None}


def has_chinese(sentence: str) -> bool:
    return any("一" <= character <= "鿿" for character in sentence)


def test_every_catalogue_is_in_an_offered_language() -> None:
    assert {path.name.split(".")[1] for folder in FOLDERS for path in folder.glob("*.json")} == set(i18n.LANGUAGES)


@pytest.mark.parametrize("catalogue", NAMES)
def test_a_catalogue_has_the_same_keys_in_every_language(catalogue: str) -> None:
    assert read_catalogue(catalogue, "en").keys() == read_catalogue(catalogue, "zh").keys()


@pytest.mark.parametrize("catalogue", NAMES)
def test_a_text_has_the_same_placeholders_in_every_language(catalogue: str) -> None:
    english, chinese = read_catalogue(catalogue, "en"), read_catalogue(catalogue, "zh")
    different = {key for key in english if placeholders(english[key]) != placeholders(chinese.get(key, ""))}
    assert not different


BLANK_KEYS = {"language.between_sentences", "language.unspaced_letters"}
"""Rules of a language, which may be a blank or nothing."""


@pytest.mark.parametrize("catalogue", NAMES)
def test_no_text_is_empty_and_english_has_no_chinese(catalogue: str) -> None:
    english, chinese = read_catalogue(catalogue, "en"), read_catalogue(catalogue, "zh")
    texts = [*english.items(), *chinese.items()]
    assert not [key for key, sentence in texts if not sentence.strip() and key not in BLANK_KEYS]
    assert not [key for key, sentence in english.items() if has_chinese(sentence)]


@pytest.mark.parametrize("catalogue", NAMES)
def test_no_english_text_leaves_the_choice_of_a_plural_to_its_reader(catalogue: str) -> None:
    """Regression: "6 byte(s)" and "1 frame(s)"."""
    english = read_catalogue(catalogue, "en")
    assert not [key for key, sentence in english.items() if re.search(r"[a-z]\(e?s\)", sentence)]


@pytest.mark.parametrize("catalogue", NAMES)
def test_no_text_installs_drivebus_from_an_index_that_does_not_have_it(catalogue: str) -> None:
    """Regression: "pip install 'drivebus[parquet]'" found no package. Its source is installed: '.[parquet]'."""
    for language in i18n.LANGUAGES:
        texts = read_catalogue(catalogue, language)
        assert not [key for key, text in texts.items() if re.search(r"\binstall\b[^`.]*drivebus\b", text)]


@pytest.mark.parametrize("catalogue", NAMES)
def test_every_text_longer_than_a_name_is_translated(catalogue: str) -> None:
    english, chinese = read_catalogue(catalogue, "en"), read_catalogue(catalogue, "zh")
    same = {
        key for key in english if english[key] == chinese.get(key) and re.search(r"[a-z]{2,} [a-z]{2,}", english[key])
    }
    assert not same


def half_width_marks(text: str) -> list[str]:
    """Return each half-width mark after a Chinese word, or between codes or links, with its surroundings."""
    prose = re.sub(r"```.*?```|`[^`\n]*`|\]\([^)]*\)", "·", text, flags=re.DOTALL)
    found = re.finditer(r"[一-鿿）”](?:[,;:!?.](?=\s|$)| ?\((?!\d+\)))|·, [\[·]", prose)
    return [prose[max(0, mark.start() - 10) : mark.end() + 10] for mark in found]


@pytest.mark.parametrize(
    "text",
    [
        "停机, 确认",
        "错误: 三处",
        "当前 ({n})",
        "当前(三条)",
        "已停。完了.",
        "未知;\n",
        "`a`, `b`",
        "[甲](x.md), [乙](y.md)",
    ],
)
def test_a_half_width_mark_after_a_chinese_word_is_found(text: str) -> None:
    assert len(half_width_marks(text)) == 1


@pytest.mark.parametrize(
    "text", ["停机，确认", "[列表](x.md)", "`[最低, 最高]`", "tcp://主机:端口", "手册 §2.2 与 §3 (5)", "a, b"]
)
def test_marks_of_code_links_and_paragraph_numbers_are_none(text: str) -> None:
    assert half_width_marks(text) == []


@pytest.mark.parametrize("catalogue", NAMES)
def test_a_chinese_text_has_full_width_marks(catalogue: str) -> None:
    texts = read_catalogue(catalogue, "zh")
    assert {key: marks for key, text in texts.items() if (marks := half_width_marks(text))} == {}


def test_a_chinese_page_has_full_width_marks() -> None:
    """Regression: generated pages had "; " between the values of a parameter, and ", " in the name of a source."""
    root = SOURCE.parents[1]
    pages = [*root.glob("*.zh.md"), *root.glob("docs/**/*.zh.md")]
    assert len(pages) > 100
    found = {str(page.relative_to(root)): half_width_marks(page.read_text(encoding="utf-8")) for page in pages}
    assert {page: marks for page, marks in found.items() if marks} == {}


def test_no_two_catalogues_have_the_same_key() -> None:
    for one, other in combinations(NAMES, 2):
        assert not read_catalogue(one, "en").keys() & read_catalogue(other, "en").keys(), (one, other)


def test_every_text_is_found_by_its_key() -> None:
    for language in i18n.LANGUAGES:
        for catalogue in NAMES:
            assert read_catalogue(catalogue, language).items() <= i18n.catalogue(language).items()


def test_a_list_in_a_sentence_has_the_mark_of_the_language_between_its_items() -> None:
    """Regression: names had ", " between them in a Chinese sentence, joined before its language was known."""
    error = errors.NotFound("plant.no_drive", id="x", known=["fan-1", "fan-2"])
    assert "fan-1, fan-2" in error.text("en")
    assert "fan-1、fan-2" in error.text("zh")
    names = (Text("supply", "送风"), Text("extract", "排风"))
    assert i18n.text("plant.no_drive", "zh", id="x", known=names).count("送风、排风") == 1


def joined_parameters() -> Iterator[str]:
    """Yield each argument that is a joined list, of a raised error, an issue or a note of a sentence."""
    for file, node in nodes():
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            is_sentence = isinstance(node.args[0].value, str) and not any(
                keyword.arg is None for keyword in node.keywords
            )
            arguments = [*node.args[1:], *(keyword.value for keyword in node.keywords)]
            for argument in arguments if is_sentence else ():
                if has_join(argument) and re.match(r"', '\.join\(", text := ast.unparse(argument)):
                    yield f"{file}:{node.lineno} {text}"


def has_join(expression: ast.expr) -> bool:
    """Return whether an expression names ``join``: only these are written out as text, which takes long."""
    return any(isinstance(node, ast.Attribute) and node.attr == "join" for node in ast.walk(expression))


def test_no_list_of_a_sentence_is_joined_before_its_language_is_known() -> None:
    assert list(joined_parameters()) == []


@cache
def nodes() -> list[tuple[str, ast.AST]]:
    """Return the nodes of the code with their files: its constants, calls and raised errors."""
    return [
        (path.relative_to(SOURCE).as_posix(), node)
        for path in sorted(SOURCE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant | ast.Call | ast.Raise)
    ]


def named_keys() -> set[tuple[str, str]]:
    """Return every string constant of the code that looks like a key, with its file."""
    prefixes = {key.split(".")[0] for key in i18n.catalogue("en")}
    strings = ((file, node.value) for file, node in nodes() if isinstance(node, ast.Constant))
    return {
        (file, value)
        for file, value in strings
        if isinstance(value, str) and KEY.fullmatch(value) and value.split(".")[0] in prefixes
    }


def raised_keys() -> set[tuple[str, str]]:
    """Return the constant keys of raised errors of ``drivebus.errors``, with the file."""
    calls = ((file, node.exc) for file, node in nodes() if isinstance(node, ast.Raise))
    return {
        (file, call.args[0].value)
        for file, call in calls
        if isinstance(call, ast.Call) and call.args and isinstance(call.args[0], ast.Constant)
        if isinstance(getattr(errors, getattr(call.func, "id", ""), None), type)
    }


def test_every_key_of_an_error_has_a_text() -> None:
    known = i18n.catalogue("en").keys()
    raised = raised_keys()
    assert len(raised) > 3
    assert not {(file, key) for file, key in raised if key not in known}


def test_every_key_in_the_code_has_a_text() -> None:
    """Prefixes of keys in f-strings and names of modules, files and operations are no keys."""
    known = i18n.catalogue("en").keys()
    starts = {".".join(key.split(".")[:n]) for key in known for n in range(1, key.count(".") + 1)}
    starts |= OPERATIONS.keys() | WEB_OPERATIONS.keys()
    missing = {(file, key) for file, key in named_keys() if key not in known and key not in starts}
    missing = {(file, key) for file, key in missing if key.rpartition(".")[2] not in FILES}
    missing = {(file, key) for file, key in missing if not (key[-1] == "_" and any(k.startswith(key) for k in known))}
    assert not {(file, key) for file, key in missing if not (SOURCE / (key.replace(".", "/") + ".py")).exists()}


def test_a_text_within_a_text_is_in_the_same_language() -> None:
    """The reason of a start that was not sent is in the language of the user."""
    why = errors.StartInhibited("drives.limits_unchecked")
    inner = i18n.text("drives.limits_unchecked", "zh")
    assert inner in i18n.text("drives.not_started", "zh", why=why)
    assert inner != i18n.text("drives.limits_unchecked", "en")


KEY_PREFIX = re.compile(r"""["'`]([a-z][a-z0-9_]*\.[a-z0-9_.]*)(?:\$?\{|["'`])""")
COMPUTED_PREFIXES = {
    "signal.",
    "drives.kind_",
    "page.by_",
    "page.size_",
    "page.sort_",
    "plant_config.key.",
    "page.counter_",
    "page.error_",
}
"""Prefixes that the code computes, so that they are not found in it."""


def test_every_text_is_used() -> None:
    """The code has the key of every text, or the prefix of a computed key."""
    files = [path for kind in ("py", "js", "toml") for path in SOURCE.rglob(f"*.{kind}") if "vendor" not in path.parts]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    words = set(re.findall(r"[\w.-]+", text))
    prefixes = {found for found in KEY_PREFIX.findall(text) if re.fullmatch(r"\w+\..+[._]", found)} | COMPUTED_PREFIXES
    keys = {key for catalogue in NAMES for key in read_catalogue(catalogue, "en")}
    unused = {key for key in keys if key not in words and not key.startswith(tuple(prefixes))}
    assert {key for key in unused if not {key.partition(".")[2], key.rpartition(".")[2]} & words} == set()


RETIRED = {
    "起动": "启动",
    "从机地址": "站号",
    "站地址": "站号",
    "仿真": "模拟",
    "说明书": "手册",
    "给定频率": "设定频率",
    "回声": "回波",
}
"""Chinese words that are not used, with the word of the glossary. Names of parameters are those of the keypad."""


RETIRED_BESIDE_MANUALS = {
    "跳闸": "故障停机",
    "端口丢失": "端口断开",
    "样例帧": "示例帧",
    "示例报文": "示例帧",
    "报文实例": "示例帧",
    "机型文件": "型号文件",
    "工厂文件": "工厂配置文件",
    "全厂配置文件": "工厂配置文件",
    "历史数据库": "历史库",
    "停止未确认": "停机未确认",
    "预备": "准备启动，启动令牌",
    "失能": "松手停机定时器",
    "租约": "控制权",
    "线路状况": "线路质量",
    "虚拟终端": "伪终端",
    "散列": "哈希",
    "串口参数": "通信参数",
    "串口设置": "通信参数",
}
"""Chinese words that only the texts of a maker's manual may have, with the word of the glossary."""


def chinese_texts() -> dict[Path, str]:
    """Return catalogues, pages and sources of pages with their text."""
    root = SOURCE.parents[1]
    pages = [*root.glob("*.zh.md"), *root.glob("docs/**/*.zh.md"), *root.glob("docs/generator/*")]
    data = [*SOURCE.glob("**/*.zh.json"), *SOURCE.glob("**/*.zh.toml"), *root.glob("docs/security/*.tsv")]
    return {path: path.read_text(encoding="utf-8") for path in [*pages, *data] if path.is_file()}


def test_a_term_has_one_chinese_word() -> None:
    texts = chinese_texts() | {path: path.read_text("utf-8") for path in SOURCE.glob("profiles/data/**/*.toml")}
    assert len(texts) > 40
    assert [(path.name, old, new) for path, text in texts.items() for old, new in RETIRED.items() if old in text] == []


def test_a_term_has_one_chinese_word_outside_of_what_manuals_call_it() -> None:
    """Regression: a trip, a profile and a port that is lost had two names each."""
    texts = {path: text for path, text in chinese_texts().items() if path.parent.name not in {"models", "protocols"}}
    assert len(texts) > 80
    used = [
        (path.name, old, new)
        for path, text in texts.items()
        for old, new in RETIRED_BESIDE_MANUALS.items()
        if old in text
    ]
    assert used == []


def test_the_keypad_settings_and_the_help_of_a_model_have_the_chinese_words_of_the_glossary() -> None:
    """These are no texts of a manual: six of them had the word of circuit breakers for a trip of a drive."""
    used = []
    for profile in map(profiles.load, profiles.models()):
        texts = [*profile.keypad, *(parameter.help for parameter in profile.parameters.values() if parameter.help)]
        used += [(profile.model, old) for old in RETIRED_BESIDE_MANUALS for text in texts if old in text.zh]
    assert used == []


@pytest.mark.parametrize("text", [None, "{"])
def test_an_unreadable_catalogue_hides_no_error(monkeypatch: pytest.MonkeyPatch, text: str | None) -> None:
    """The report of an error does not fail; the next one has its text again."""

    def refused(*_: Any, **__: Any) -> Any:
        if text is None:
            raise OSError(24, "Too many open files")
        return io.StringIO(text)

    i18n.catalogue.cache_clear()
    with monkeypatch.context() as context:
        context.setattr("builtins.open", refused)
        message = i18n.text("bus.no_reply", "zh", station=3)
        assert "bus.no_reply" in message and "3" in message and not i18n.known("bus.no_reply")
    assert "bus.no_reply" not in i18n.text("bus.no_reply", "zh", station=3) and i18n.known("bus.no_reply")


@pytest.mark.parametrize(
    ("language", "state", "right"), [("en", "not ready", "stop"), ("zh", "未就绪", "停机（stop）")]
)
def test_a_state_or_a_right_in_a_sentence_is_in_its_language(language: str, state: str, right: str) -> None:
    assert state in i18n.text("drives.start_confirmed", language, state=DriveState.NOT_READY)
    assert right in i18n.text("auth.forbidden", language, right=Right.STOP)


@pytest.mark.parametrize(
    ("drive", "sentence"),
    [
        ("风机", "风机报告故障：过压"),
        ("8号风机", "8号风机报告故障：过压"),
        ("风机 8", "风机 8 报告故障：过压"),
        ("fan-1", "fan-1 报告故障：过压"),
    ],
)
def test_a_chinese_name_in_a_chinese_sentence_has_no_spaces(drive: str, sentence: str) -> None:
    assert i18n.text("alarms.text.fault", "zh", drive=drive, fault="过压") == sentence


def test_the_space_before_a_chinese_name_goes_and_its_own_spaces_stay() -> None:
    assert i18n.text("plant.waiver_needed", "zh", drive="锅炉 风机", why="无").startswith(
        "通信中断后锅炉 风机可能继续运行"
    )


def test_a_third_language_joins_lists_in_its_own_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Reasons of an interlock and steps at the keypad were joined for English and Chinese by hand."""
    rules = {"language.between_items": "・", "language.between_clauses": "／", "language.between_sentences": ""}
    (tmp_path / "language.ja.json").write_text(json.dumps(rules), encoding="utf-8")
    monkeypatch.setattr(i18n, "_FOLDERS", [*i18n._FOLDERS, str(tmp_path)])
    monkeypatch.setattr("drivebus.values.LANGUAGES", (*i18n.LANGUAGES, "ja"))
    i18n.catalogue.cache_clear()
    try:
        pump, fan = Text("pump", "泵", (("ja", "ポンプ"),)), Text("fan", "风机")
        assert Text.join([pump, fan], "items") == Text("pump, fan", "泵、风机", (("ja", "ポンプ・fan"),))
        assert Text.join([pump, fan], "clauses").in_language("ja") == "ポンプ／fan"
        assert Text.join([pump, fan], "sentences") == Text("pump fan", "泵风机", (("ja", "ポンプfan"),))
    finally:
        i18n.catalogue.cache_clear()


def test_a_list_keeps_the_languages_that_only_its_parts_have() -> None:
    """A fault of a profile in German stays German where the drive reports two."""
    hot, low = Text("hot", "过热", (("de", "heiß"),)), Text("low", "欠压")
    assert Text.join([hot, low], "clauses").in_language("de") == "heiß; low"
    assert Text.join([], "items") == Text("", "")


def test_lists_of_a_sentence_have_the_separators_of_its_language() -> None:
    engine = InterlockEngine([InterlockConfig(id="flow", drives=("fan",), require="a.x > b.x and c.state == running")])
    engine.evaluate({}, 0.0)
    why = engine.violations("fan")[0].message_params["why"]
    steps = keypad_steps(
        tuple(UnmetPrecondition(name, 1, (2,), Text("set it.", "设置。"), None) for name in ("F1", "F2"))
    )
    assert "a.x has no good value, b.x has no good value; c.state == running required" in why.en
    assert "a.x 没有可信的值、b.x 没有可信的值；要求 c.state == running" in why.zh
    assert (" F2" in steps.en, " F2" in steps.zh) == (True, False)


def test_the_page_and_the_command_line_close_the_same_gaps() -> None:
    """The letters stood in the page's script and in Python; a language with such letters needs no code now."""
    script = (Path(i18n.__file__).parents[1] / "web/static/js/i18n.js").read_text(encoding="utf-8")
    assert 'found["language.unspaced_letters"]' in script and not re.search(r"u4e00|u3000", script, re.IGNORECASE)
    letters = re.compile(i18n.text("language.unspaced_letters", "zh"))
    assert all(letters.fullmatch(letter) for letter in "风，（") and not any(map(letters.match, "a8 "))


@pytest.mark.parametrize(
    ("action", "subject", "expected"),
    [("停止", "循环泵", "停止循环泵"), ("停止", "pump 1", "停止 pump 1"), ("jog", "循环泵", "jog 循环泵")],
)
def test_two_chinese_values_side_by_side_have_no_space_between_them(action: str, subject: str, expected: str) -> None:
    """Regression: "循环泵 正在运行"."""
    assert i18n.text("audit.sentence", "zh", action=action, subject=subject) == expected


SENTENCES = {"text", "print_message", "print_note", "bilingual_text", "localized", "publish_event", "raise_alarm"}
"""Functions whose keywords are the parameters of a sentence."""


def lists_joined_by_hand(source: str) -> list[str]:
    """Return the parameters of sentences that are joined with the comma of one language."""
    if "join" not in source:
        return []
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    sentences = [call for call in calls if ast.unparse(call.func).rpartition(".")[2] in SENTENCES]
    found = [ast.unparse(keyword) for call in sentences for keyword in call.keywords if has_join(keyword.value)]
    return [keyword for keyword in found if "', '.join(" in keyword]


def test_a_list_in_a_sentence_has_the_mark_of_its_language() -> None:
    """Chinese puts 、 between names: ``i18n.join``, ``output.join``, ``Text.join_names``."""
    assert lists_joined_by_hand("output.text('x', names=', '.join(found) or '-')") != []
    files = sorted(Path(i18n.__file__).parents[1].rglob("*.py"))
    assert len(files) > 400
    assert {file.name: found for file in files if (found := lists_joined_by_hand(file.read_text("utf-8")))} == {}
    assert Text.join_names(["fan-1", "fan-2"]) == Text("fan-1, fan-2", "fan-1、fan-2")


def log_lines_of_one_language(source: str) -> list[str]:
    """Return the words of log calls that are written in the source."""
    if not re.search(r"\b(LOG|_log)\b", source):
        return []
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    logs = [
        call for call in calls if re.fullmatch(r"(LOG|_log)\.(info|warning|error|exception)", ast.unparse(call.func))
    ]
    texts = [ast.unparse(log.args[0]) for log in logs if isinstance(log.args[0], ast.Constant | ast.JoinedStr)]
    return [text for text in texts if re.search("[a-z]{2,}", text)]


def test_every_line_of_the_log_follows_the_language_of_the_service() -> None:
    """Regression: some lines at the end of a Chinese service were English."""
    assert log_lines_of_one_language("LOG.error('no socket in %s', folder)") != []
    assert log_lines_of_one_language("LOG.error('%s %s', method, path)") == []
    files = [path for path in SOURCE.rglob("*.py") if "testing" not in path.parts]
    assert {path.name: found for path in files if (found := log_lines_of_one_language(path.read_text("utf-8")))} == {}


def test_only_a_language_with_unspaced_letters_is_searched_for_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule ran on each English sentence too, with letters that never match."""
    searched: list[str] = []
    monkeypatch.setattr(i18n, "_close_gaps", lambda sentence, *_: searched.append(sentence) or sentence)
    english = i18n.text("alarms.text.fault", "en", drive="风机", fault="过压")
    assert (english, searched) == ("风机 reports a fault: 过压", [])
    i18n.text("alarms.text.fault", "zh", drive="风机", fault="过压")
    assert searched == [i18n.catalogue("zh")["alarms.text.fault"]]


def test_every_audited_action_has_a_text_in_both_languages() -> None:
    """An identifier such as ``audit.opened`` means nothing to an auditor."""
    source = "".join(path.read_text("utf-8") for path in (SOURCE / "service").rglob("*.py"))
    own = set(re.findall(r'(?:Entry\(|what=|RECORDS_MISSING: Final = )"(audit\.[a-z]+)"', source))
    recorded = own | {name for name, operation in (OPERATIONS | WEB_OPERATIONS).items() if operation.mutates}
    words = {"audit.did_" + re.sub("[.-]", "_", name) for name in recorded}
    assert len(own) == 5 and words - set(i18n.catalogue("en")) == set()
