"""``prove``: what only the drive and a person beside it can answer. Asks before each step, keeps what is proved."""

from __future__ import annotations

import sys
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from drivebus.cli import connect, voice
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import drive_verb, tell
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry import DryRun
    from drivebus.cli.ending import Ending
    from drivebus.cli.keyboard import Keys
    from drivebus.drives import Drive
    from drivebus.drives.proofs import CodingFound
    from drivebus.drives.state import Direction, Outcome

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Bench:
    """The drive, and the person beside it."""

    bus: Bus
    drive: Drive
    keys: Keys
    ending: Ending

    async def key(self, question: str, **params: Any) -> str | None:
        """The next key after a question; None where the end comes first."""
        self.keys.forget()
        voice.note(question, **params)
        return await self.ending.race(self.keys.get())

    async def agreed(self, question: str, **params: Any) -> bool:
        """Only y is yes."""
        return await self.key(question, **params) in ("y", "Y")


Step = Callable[[Bench], Awaitable[Exit]]


async def _prove(target: Target) -> Exit:
    from drivebus.cli.ending import listening
    from drivebus.cli.keyboard import reading
    from drivebus.errors import ConfigurationError

    if not sys.stdin.isatty():
        raise ConfigurationError("prove.no_terminal")
    with listening() as ending:
        async with connect.drive(target) as (bus, drive):
            steps = left(drive.dialect.settings)
            if not steps:
                voice.document({"event": "nothing", "settings": drive.dialect.settings}, stream=True)
                voice.tell("prove.nothing", model=drive.profile.model)
            with reading() as keys:
                return await _walk(Bench(bus, drive, keys, ending), steps)


def left(settings: Mapping[str, Any]) -> list[Step]:
    """What this drive has not proved yet, in the order in which one proof needs another."""
    steps: list[Step] = [_query_coding] if settings.get("query_coding") == "unknown" else []
    steps += [_setpoint_coding] if settings.get("setpoint_coding") == "unknown" else []
    return steps + ([_direction] if settings.get("direction_proved") is False else [])


async def _walk(bench: Bench, steps: list[Step]) -> Exit:
    for step in steps:
        code = await step(bench)
        if code is not Exit.DONE:
            return code
    return Exit.DONE


async def _query_coding(bench: Bench) -> Exit:
    """Reads only."""
    from drivebus.drives.proofs import KEYPAD_HZ

    if not await bench.agreed("prove.ask_query", keypad_hz=KEYPAD_HZ):
        return Exit.INTERRUPTED
    return _tell_coding(bench, "query_coding", await bench.drive.prove_query_coding(KEYPAD_HZ))


async def _setpoint_coding(bench: Bench) -> Exit:
    from drivebus.drives.dzb_coding import CAP_HZ
    from drivebus.drives.proofs import RUN_S

    if not await bench.agreed("prove.ask_setpoint", cap_hz=CAP_HZ, seconds=RUN_S):
        return Exit.INTERRUPTED
    found = await _moving(bench, bench.drive.prove_setpoint_coding())
    return Exit.INTERRUPTED if found is None else _tell_coding(bench, "setpoint_coding", found)


async def _direction(bench: Bench) -> Exit:
    from drivebus.drives.proofs import JOG_CAP_HZ, JOG_S
    from drivebus.drives.state import Direction

    ways = {"f": Direction.FORWARD, "r": Direction.REVERSE}

    async def watched() -> Direction | None:
        return ways.get((await bench.key("prove.ask_way") or "").lower())

    if not await bench.agreed("prove.ask_jog", cap_hz=JOG_CAP_HZ, seconds=JOG_S):
        return Exit.INTERRUPTED
    outcome = await _moving(bench, bench.drive.prove_direction(JOG_CAP_HZ, watched))
    return Exit.INTERRUPTED if outcome is None else _tell_direction(bench, outcome)


async def _moving(bench: Bench, proof: Awaitable[T]) -> T | None:
    """What may move the motor: however it ends other than by itself, the drive is stopped. None: the user ended it."""
    from drivebus.cli.verbs.run import nothing_moved

    try:
        found = await bench.ending.race(proof)
    except BaseException as error:
        if not nothing_moved(error):
            await bench.drive.stop()
        raise
    if found is None:
        tell(await bench.drive.stop(), bench.bus.now(), event="stopped", stream=True)
    return found


def _tell_coding(bench: Bench, setting: str, found: CodingFound) -> Exit:
    words = [f"{word:04X}H" for word in found.words]
    if found.settled is None:
        voice.document({"event": "open", "setting": setting, "left": found.codings, "words": words}, stream=True)
        voice.tell("prove.open", setting=setting, codings=", ".join(found.codings), words=", ".join(words))
        return Exit.REFUSED
    return _tell_kept(bench, {setting: found.settled}, words=words)


def _tell_direction(bench: Bench, outcome: Outcome) -> Exit:
    settings = bench.drive.dialect.settings
    tell(outcome, bench.bus.now(), event="jogged", stream=True)
    if settings["direction_proved"] is not True:
        voice.tell("prove.unseen")
        return Exit.REFUSED
    return _tell_kept(bench, {name: settings[name] for name in ("direction_field", "direction_proved")})


def _tell_kept(bench: Bench, settings: dict[str, Any], **more: Any) -> Exit:
    """What is proved, and whether a later program will know it."""
    from drivebus.drives.drive import FORGETFUL

    kept = bench.bus.port.url.partition(":")[0] not in FORGETFUL
    voice.document({"event": "proved", "settings": settings, "kept": kept} | more, stream=True)
    for name, value in settings.items():
        voice.tell("prove.proved", setting=name, value=str(value).lower())
    voice.tell("prove.kept" if kept else "prove.not_kept")
    return Exit.DONE


def _plan(dry: DryRun) -> Exit:
    from drivebus.drives.book import Book
    from drivebus.drives.dialect import Stop
    from drivebus.drives.dzb import DzbDialect
    from drivebus.drives.dzb_coding import candidates, cap_word
    from drivebus.drives.modbus import ModbusDialect
    from drivebus.drives.proofs import JOG_CAP_HZ

    steps, dialect = left(dry.dialect.settings), dry.dialect
    if isinstance(dialect, DzbDialect) and steps:
        dry.add("state", [dialect.query(0), dialect.query(1)])
    if isinstance(dialect, DzbDialect) and _setpoint_coding in steps:
        dry.add("start", [frame.request for frame in dialect.start(None, cap_word(candidates(dialect.settings)))])
    if isinstance(dialect, ModbusDialect) and _direction in steps:
        word = dialect.setpoint_word(JOG_CAP_HZ)
        dry.add("set_frequency", [frame.request for frame in dialect.set_frequency(word, Book())])
        dry.add("jog_once", [frame.request for frame in dialect.proof_jog()])
    if steps:
        dry.add("stop", dialect.stop(Stop.STOP))
    return dry.show("dry.note.fewer", "dry.note.confirm")


command = drive_verb(
    "prove",
    _prove,
    _plan,
    examples=(
        "drivebus prove /dev/ttyUSB0 --model dzb100 --address 1",
        "drivebus prove /dev/ttyUSB0 --model df800 --address 2",
        "drivebus prove /dev/ttyUSB0 --model df800 --address 2 --dry-run",
    ),
)
