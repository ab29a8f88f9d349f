"""Table of the command words that stop one included model and start another one at the same register."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from drivebus import i18n, profiles
from drivebus.drives.dialects.command_word import make_command_word
from drivebus.profiles import DriveProfile
from drivebus.profiles.words import MOTION_COMMANDS, STOP_COMMANDS, CommandMap
from drivebus.values import Text
from generator.terms import localized, table

HEADS = (
    Text("register", "地址"),
    Text("word", "命令字"),
    Text("stops or resets", "停机或复位"),
    Text("starts", "启动"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Collision:
    """Command word that stops or resets one model and starts another."""

    register: int
    word: int
    model: str
    command: str
    other: str
    starts: str
    """What it begins there."""


def collisions() -> Iterator[Collision]:
    """Yield every collision of two included models."""
    loaded = [profiles.load(name) for name in profiles.models()]
    mapped = [(profile, profile.commands) for profile in loaded if profile.commands is not None]
    for profile, commands in mapped:
        for command, word in _stops(profile):
            for other, rival in mapped:
                names = make_command_word(rival.resolved(other.options)).active_names(word)
                starts = sorted(name for name in names if name.startswith(MOTION_COMMANDS) and name != "jog_stop")
                if _same_place(commands, rival) and starts and other is not profile:
                    yield Collision(
                        register=commands.register,
                        word=word,
                        model=profile.model,
                        command=command,
                        other=other.model,
                        starts=starts[0],
                    )


def _same_place(commands: CommandMap, rival: CommandMap) -> bool:
    return (commands.space, commands.register) == (rival.space, rival.register)


def _stops(profile: DriveProfile) -> Iterator[tuple[str, int]]:
    assert profile.commands is not None
    words = dict(profile.commands.values) or {name: bit.value for name, bit in profile.commands.bits.items()}
    for name, word in words.items():
        if name in (*STOP_COMMANDS, "reset"):
            yield name, word


def collision_table(language: str) -> str:
    """Return the collisions, one row a word."""
    rows: dict[tuple[int, int], tuple[set[str], set[str]]] = defaultdict(lambda: (set(), set()))
    for found in collisions():
        stops, starts = rows[found.register, found.word]
        stops.add(f"{found.model} `{found.command}`")
        starts.add(f"{found.other} `{found.starts}`")
    return table(
        [localized(head, language) for head in HEADS],
        [
            (
                f"{register:04X}H",
                f"{word:04X}H",
                *(i18n.join(sorted(names), "items", language) for names in (stops, starts)),
            )
            for (register, word), (stops, starts) in sorted(rows.items())
        ],
    )
