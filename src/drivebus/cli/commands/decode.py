"""``decode``: explain a frame, byte for byte."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, Choice, CliCommand, Option
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    import click

    from drivebus.protocols.describe import FrameDescription, Interpretation, Note


_END_MARKS = {":": "\r\n", "*": "\r"}
"""End marks, which manuals do not print, by the first character of a frame (Modbus ASCII, C320 ASCII)."""


def parse_hex(text: str) -> bytes:
    """Parse ``2A 30 30`` or ``2a3030``; blanks, colons between pairs and 0x are allowed. Raises ValueError.

    A frame as characters, such as ``:010600F9``, gets its end mark.
    """
    text = text.strip()
    if text[:1] in _END_MARKS:
        return ("".join(text.split()) + _END_MARKS[text[0]]).encode("ascii")
    digits = text.replace("0x", " ").replace("0X", " ").replace(":", " ").replace(",", " ").split()
    if not digits or any(len(part) % 2 or not part.isascii() for part in digits):
        raise ValueError(text)
    return bytes.fromhex("".join(digits))


def _join_words(ctx: click.Context, param: click.Parameter, parts: tuple[str, ...]) -> bytes:
    """Join the words of the shell to one frame."""
    data: bytes = HEX.convert(" ".join(parts), param, ctx)
    return data


HEX = options.ParsedType("hex", parse_hex, "cli.expect.hex")


def _decode(hex: bytes, model: str, encoding: str | None, direction: str | None, request: bytes | None) -> ExitCode:
    from drivebus.commissioning.decode.describe import describe_frame

    data = hex
    description = describe_frame(model, data, encoding=encoding, direction=direction, request=request)
    output.print_json(description_json(model, data, description))
    output.print_text(description_text(model, data, description))
    return ExitCode.DONE if description.valid else ExitCode.INVALID_FRAME


def description_json(model: str, data: bytes, description: FrameDescription) -> dict[str, Any]:
    """Return the JSON of a frame; ``fields`` has at least the keys of the test vectors."""
    from drivebus.commissioning.decode.describe import alternative_fields

    other = alternative_fields(description)
    return {
        "model": model,
        "family": description.family,
        "encoding": description.encoding,
        "direction": description.direction,
        "valid": description.valid,
        "hex": data,
        "fields": dict(description.fields),
        "problems": _sentences(description.problems),
        "errata": _sentences(description.errata),
        "hazards": _sentences(description.hazards),
        "canonical_hex": description.canonical,
        "ambiguous": other is not None,
        "meant": None if other is None else dict(other),
        "interpretations": [
            {"text": _sentence(interpretation.note), "fields": dict(interpretation.fields)}
            for interpretation in description.interpretations
        ],
    }


def description_text(model: str, data: bytes, description: FrameDescription) -> str:
    """Format the explanation of a frame."""
    from drivebus.cli.output import two_columns
    from drivebus.drives.state import names_fault_label

    verdict = output.text("decode.valid" if description.valid else "decode.invalid")
    direction = output.text(f"decode.{description.direction}")
    lines = [
        output.text("decode.title", model=model, encoding=description.encoding, direction=direction, verdict=verdict)
    ]
    lines.append(f"  {output.to_json_value(data)}")
    if description.fields:
        fields = {name: field_text(name, value) for name, value in description.fields.items()}
        if "fault" in fields and names_fault_label(fields["fault_text"], fields["fault"]):
            del fields["fault"]
        rows = [(field_label(name), text) for name, text in fields.items()]
        lines += ["", two_columns(rows, output.page_cells())]
    for kind in ("problems", "errata", "hazards"):
        texts = [output.text(f"decode.{kind}", text=text) for text in _sentences(getattr(description, kind))]
        lines += [output.wrap_for(line, sys.stdout) for line in texts]
    if description.canonical is not None and description.canonical != data:
        lines.append(output.text("decode.canonical", hex=output.to_json_value(description.canonical)))
    lines += [
        output.wrap_for(_alternative_text(interpretation), sys.stdout) for interpretation in description.interpretations
    ]
    return "\n".join(lines)


def _alternative_text(reading: Interpretation) -> str:
    fields = [
        output.text("decode.equals", name=field_label(name), value=field_text(name, each))
        for name, each in reading.fields.items()
    ]
    return output.text("decode.reading", text=_sentence(reading.note), fields=output.join(fields, "phrases"))


def field_label(name: str) -> str:
    """Return the label of a field; its JSON name if it has none."""
    from drivebus.commissioning.decode import labels

    return labels.field_label(name, output.language())


def field_text(name: str, value: Any) -> str:
    """Format the value of a field."""
    from drivebus.commissioning.decode import labels

    label = labels.value_text(name, value, output.language())
    if label is not None:
        return label
    if isinstance(value, dict):
        pairs = [
            output.text("decode.pair", name=field_label(member), value=field_text(member, each))
            for member, each in value.items()
        ]
        return output.join(pairs, "phrases")
    if isinstance(value, list | tuple):
        texts = [field_text(name, each) for each in value]
        return output.join(texts, "clauses" if any(isinstance(each, dict) for each in value) else "items")
    return str(output.to_json_value(value)) if not isinstance(value, str | int | float) else str(value)


def _sentence(note: Note) -> str:
    return output.text(note[0], **note[1])


def _sentences(notes: tuple[Note, ...]) -> list[str]:
    return [_sentence(note) for note in notes]


command = CliCommand(
    "decode",
    callback=_decode,
    params=[
        Argument(["hex"], nargs=-1, required=True, type=str, callback=_join_words, metavar="HEX..."),
        options.model_option(),
        options.encoding_option(),
        Option(["--direction"], type=Choice(["request", "response"]), example="--direction response"),
        Option(["--request"], type=HEX, metavar="HEX", example='--request "51 03 01 30 31 30 31 30 30 30 30"'),
    ],
    examples=(
        "drivebus decode --model c320 2A 30 30 34 30 33 30 30 30 30 30 31 42 37 0D",
        "drivebus decode --model vc660 --request 0103300200012ACA 01 03 02 13 88 B5 12",
        "drivebus decode --model df800 :010600F9",
        "drivebus decode --model dzb100 --json 4303013031303130334538",
    ),
)
