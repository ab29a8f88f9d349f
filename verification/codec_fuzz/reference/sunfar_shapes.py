"""The shapes of C320 frames, byte by byte."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

from verification.codec_fuzz.reference.frame_shapes import ANY, Bytes, FrameShape, literal_places

Field = tuple[int, tuple[int, ...] | range | None]
"""Width, and the numbers that it may hold; None: any word."""
SHAPE_OPERATIONS = (*range(7), *range(0x10, 0x17), 0x20, 0x21)
SHAPE_STATES = (*range(6), *range(0x11, 0x17), 0x20, 0x21)
SHAPE_FAULT_STATE = 0x20
SHAPE_BROADCAST = 31
DIGIT, OCTET = range(16), range(256)


DigitSpellings = tuple[Bytes, ...]
"""The spellings of each digit."""


def sunfar_shape(
    head: int, fields: Sequence[Field], spelt: DigitSpellings, packed: bool, loose: bool, ways: tuple[int, int]
) -> FrameShape:
    """The form of these fields; ``ways``: spellings of the sum, and of one byte of it."""
    places = [place for field in (*fields, (4, None)) for place in _places(field, spelt, packed, loose)]
    check = range(len(places) - 3, len(places) + 1)
    return FrameShape((*literal_places(bytes((head,))), *places, *literal_places(b"\r")), check, "sum", *ways)


@cache
def _places(field: Field, spelt: DigitSpellings, packed: bool, loose: bool) -> list[Bytes]:
    width, numbers = field
    digits = [{number >> 4 * n & 15 for number in numbers or ()} or set(DIGIT) for n in reversed(range(width))]
    nibbles = [frozenset().union(*(spelt[digit] for digit in place)) for place in digits]
    if not packed:
        return nibbles
    free = [{0}, {0}, set(ANY), set(ANY)]
    octets = [{number >> 8 * n & 255 for number in numbers or ()} or free[-1 - n] for n in reversed(range(width))]
    return [
        frozenset(octet) | (nibble if loose else frozenset()) for octet, nibble in zip(octets, nibbles, strict=True)
    ]


def reply_fields(asked: tuple[int, ...]) -> Iterator[tuple[Field, ...]]:
    """What may answer a request with these fields."""
    address, kind = (2, asked[:1]), asked[1]
    if asked[0] == SHAPE_BROADCAST:
        return
    yield address, (1, (6, 7, 8)), (2, (0,))
    head, group, any_item = (address, (1, range(5)), (2, SHAPE_STATES)), (1, asked[3:4]), (2, OCTET)
    if kind == 4:
        yield *head, (1, (0,)), any_item, (4, None)
    elif kind == 0:
        yield *head, group, (1, DIGIT), (1, DIGIT), (4, None)
        yield address, (1, range(5)), (2, (SHAPE_FAULT_STATE,)), group, any_item, (4, None)
    else:
        yield from _item_fields(asked, address, group)


def _item_fields(asked: tuple[int, ...], address: Field, group: Field) -> Iterator[tuple[Field, ...]]:
    for states, items in ((SHAPE_STATES, asked[4:5]), ((SHAPE_FAULT_STATE,), OCTET)):
        if asked[1] in (1, 2):
            yield address, (1, range(5)), (2, states), group, (2, items), (4, None)
        else:
            yield address, (1, (0,)), (2, states), group, (2, items), (4, asked[5:])
            yield address, (1, range(1, 5)), (2, states), group, (2, items), (4, (0,))


def request_fields() -> Iterator[tuple[Field, ...]]:
    """What may be asked, by whomever."""
    address, operation = (2, range(32)), (2, SHAPE_OPERATIONS)
    yield address, (1, (0,)), operation, (1, DIGIT), (2, (0,))
    yield address, (1, (1,)), operation, (1, (0,)), (2, OCTET)
    yield address, (1, (2,)), operation, (1, DIGIT), (2, OCTET)
    yield address, (1, (3, 5)), operation, (1, DIGIT), (2, OCTET), (4, None)
    yield address, (1, (4,)), operation, (4, None)
