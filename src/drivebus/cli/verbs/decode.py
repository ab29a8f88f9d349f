"""``decode``: a frame explained, byte for byte. The explaining is ``commissioning.explain``'s."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, voice
from drivebus.cli.command import Argument, OneOf, Option, Verb
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    import click

    from drivebus.protocols.describe import Candidate, Description, Note


_PRINTED = {":": "\r\n", "*": "\r"}
"""Frames that manuals print as characters (Modbus ASCII, C320 ASCII), by their first, with the end mark that no page
shows."""


def read_hex(text: str) -> bytes:
    """Bytes of ``2A 30 30`` or ``2a3030``; blanks, colons between pairs and 0x are allowed. A frame as its characters,
    ``:010600F9``, is taken as printed. Raises ValueError."""
    text = text.strip()
    if text[:1] in _PRINTED:
        return ("".join(text.split()) + _PRINTED[text[0]]).encode("ascii")
    digits = text.replace("0x", " ").replace("0X", " ").replace(":", " ").replace(",", " ").split()
    if not digits or any(len(part) % 2 or not part.isascii() for part in digits):
        raise ValueError(text)
    return bytes.fromhex("".join(digits))


def _joined(ctx: click.Context, param: click.Parameter, parts: tuple[str, ...]) -> bytes:
    """One frame, whether the shell handed it over in one piece or in pairs."""
    found: bytes = HEX.convert(" ".join(parts), param, ctx)
    return found


HEX = options.Parsed("hex", read_hex, "cli.expect.hex")


def _decode(hex: bytes, model: str, encoding: str | None, direction: str | None, request: bytes | None) -> Exit:
    from drivebus.commissioning.explain import explain

    data = hex
    found = explain(model, data, encoding=encoding, direction=direction, request=request)
    voice.document(as_document(model, data, found))
    voice.show(page(model, data, found))
    return Exit.DONE if found.valid else Exit.INVALID_FRAME


def as_document(model: str, data: bytes, found: Description) -> dict[str, Any]:
    """The JSON of a frame; ``fields`` has at least the keys of the worked vectors."""
    from drivebus.commissioning.explain import meant

    other = meant(found)
    return {
        "model": model,
        "family": found.family,
        "encoding": found.encoding,
        "direction": found.direction,
        "valid": found.valid,
        "hex": data,
        "fields": dict(found.fields),
        "problems": _sentences(found.problems),
        "errata": _sentences(found.errata),
        "hazards": _sentences(found.hazards),
        "canonical_hex": found.canonical,
        "ambiguous": other is not None,
        "meant": None if other is None else dict(other),
        "readings": [{"text": _sentence(one.note), "fields": dict(one.fields)} for one in found.readings],
    }


def page(model: str, data: bytes, found: Description) -> str:
    """The same for people."""
    from drivebus.cli.layout import two_columns

    verdict = voice.say("decode.valid" if found.valid else "decode.invalid")
    way = voice.say(f"decode.{found.direction}")
    lines = [voice.say("decode.title", model=model, encoding=found.encoding, direction=way, verdict=verdict)]
    lines.append(f"  {voice.plain(data)}")
    if found.fields:
        rows = [(label(name), shown(name, value)) for name, value in found.fields.items()]
        lines += ["", two_columns(rows, min(98, voice.room(sys.stdout)))]
    for kind in ("problems", "errata", "hazards"):
        said = [voice.say(f"decode.{kind}", text=text) for text in _sentences(getattr(found, kind))]
        lines += [voice.wrapped(one, sys.stdout) for one in said]
    if found.canonical is not None and found.canonical != data:
        lines.append(voice.say("decode.canonical", hex=voice.plain(found.canonical)))
    lines += [voice.wrapped(_may_mean(one), sys.stdout) for one in found.readings]
    return "\n".join(lines)


_WORDS = frozenset({"data", "register", "value", "raw", "word", "crc"})


def _may_mean(reading: Candidate) -> str:
    said = [voice.say("decode.equals", name=label(one), value=shown(one, each)) for one, each in reading.fields.items()]
    return voice.say("decode.reading", text=_sentence(reading.note), fields=voice.say("decode.and").join(said))


def label(name: str) -> str:
    """A field's name for people; what has none keeps the name that JSON gives it."""
    from drivebus.commissioning import wording

    return wording.label(name, voice.language())


def shown(name: str, value: Any) -> str:
    """A field's value; words of the wire with their hexadecimal form beside."""
    from drivebus.commissioning import wording

    said = wording.word(name, value, voice.language())
    if said is not None:
        return said
    if isinstance(value, int) and name in _WORDS:
        return f"{value} ({value:04X}H)"
    if isinstance(value, dict):
        pairs = [voice.say("decode.pair", name=label(one), value=shown(one, each)) for one, each in value.items()]
        return voice.say("decode.and").join(pairs)
    if isinstance(value, list | tuple):
        return ", ".join(shown(name, each) for each in value)
    return str(voice.plain(value)) if not isinstance(value, str | int | float) else str(value)


def _sentence(note: Note) -> str:
    return voice.say(note[0], **note[1])


def _sentences(notes: tuple[Note, ...]) -> list[str]:
    return [_sentence(note) for note in notes]


command = Verb(
    "decode",
    callback=_decode,
    params=[
        Argument(["hex"], nargs=-1, required=True, type=str, callback=_joined, metavar="HEX..."),
        options.model(),
        options.encoding(),
        Option(["--direction"], type=OneOf(["request", "response"]), example="--direction response"),
        Option(["--request"], type=HEX, metavar="HEX", example='--request "51 03 01 30 31 30 31 30 30 30 30"'),
    ],
    examples=(
        "drivebus decode --model c320 2A 30 30 34 30 33 30 30 30 30 30 31 42 37 0D",
        'drivebus decode --model vc660 --direction response --request "01 03 30 02 00 01 2A CA" 01 03 02 13 88 B5 12',
        "drivebus decode --model df800 :010600F9",
        "drivebus decode --model dzb100 --json 4303013031303130334538",
    ),
)
