"""A page for each model: everything that its profile states, in both languages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import drivebus
from drivebus import i18n
from drivebus.profiles import DriveProfile
from drivebus.profiles.load import profile_files
from drivebus.values import Text
from generator import drives, profile_tables
from generator.terms import CAPABILITIES, GRADES, colon, localized, term

PACKAGE_FOLDER = Path(drivebus.__file__).resolve().parent
FOLDER = Path("docs/reference/models")
HEADINGS = {
    "serial": Text("Serial settings, timing and limits", "通信参数、定时与限值"),
    "keypad": Text("Settings at the keypad", "面板设置"),
    "commands": Text("Command word and status word", "命令字与状态字"),
    "signals": Text("Signals", "信号"),
    "parameters": Text("Parameters", "参数"),
    "faults": Text("Faults", "故障"),
    "caveats": Text("Caveats", "注意事项"),
    "open": Text("Open questions", "待定问题"),
}
CAN, LACKS = Text("Can", "支持"), Text("Does not have", "不支持")
SOURCES = Text("Profile with its sources", "型号文件与出处")
PROTOCOL_PAGE = Text("Its protocol, with worked frames", "协议说明与示例帧")


def page(profile: DriveProfile, language: str) -> str:
    """Return the page of a model."""
    own, other = (".md", ".zh.md") if language == "en" else (".zh.md", ".md")
    switch = "中文" if language == "en" else "English"
    separator, mark = ", " if language == "en" else "、", colon(language)
    known = {name: localized(text, language) for name, text in CAPABILITIES.items()}
    lacking = [text for name, text in known.items() if name not in profile.capabilities]
    having = [text for name, text in known.items() if name in profile.capabilities]
    facts = [
        f"`--model {profile.model}`",
        f"{localized(GRADES[profile.grade], language)}{mark}{i18n.text(f'page.grade_{profile.grade}_means', language)}",
        *([f"{localized(CAN, language)}{mark}{separator.join(having)}"] if having else []),
        *([f"{localized(LACKS, language)}{mark}{separator.join(lacking)}"] if lacking else []),
    ]
    if profile.model in drives.MODELS_WITH_PAGE:
        facts.append(f"[{localized(PROTOCOL_PAGE, language)}](../../protocols/{profile.model}{own})")
    files = separator.join(_file_link(path) for path in profile_files(profile.model))
    facts.append(f"{localized(SOURCES, language)}{mark}{files}")
    title = f"{localized(profile.maker, language)} {localized(profile.title, language)}"
    head = f"# {title}\n\n[{switch}]({profile.model}{other})\n\n"
    listed = "\n".join(f"- {fact}" for fact in facts)
    sections = (
        f"\n## {localized(HEADINGS[name], language)}\n\n{text.rstrip()}\n" for name, text in _parts(profile, language)
    )
    return f"{head}{listed}\n{''.join(sections)}"


def _file_link(path: Path) -> str:
    shown = path.relative_to(PACKAGE_FOLDER).as_posix()
    return f"[`{path.name}`](../../../src/drivebus/{shown})"


def _parts(profile: DriveProfile, language: str) -> list[tuple[str, str]]:
    parts = [("serial", profile_tables.serial_settings(profile, language))]
    for name, shown, make in (
        ("keypad", profile.keypad, profile_tables.keypad),
        ("commands", profile.commands, profile_tables.commands),
        ("signals", profile.signals, profile_tables.signals),
        ("parameters", profile.parameters or profile.unplaced, profile_tables.parameters),
        ("faults", profile.faults, profile_tables.faults),
        ("caveats", profile.caveats, profile_tables.caveats),
        ("open", profile.open_questions, profile_tables.open_questions),
    ):
        if shown:
            parts.append((name, make(profile, language)))
    return parts


def index(found: Iterable[DriveProfile], language: str) -> str:
    """Return the page with the table of all models."""
    title = "Drive models" if language == "en" else "变频器型号"
    switch = "[中文](README.zh.md)" if language == "en" else "[English](README.md)"
    by_maker = sorted(found, key=lambda profile: (profile.maker.en, profile.model))
    rows = drives.models_table(by_maker, language, lambda profile: drives.model_link(profile, language, ""))
    return f"# {title}\n\n{switch}\n\n{term('models_by_maker', language)}\n\n{rows}"
