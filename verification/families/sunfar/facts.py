"""Facts of the C320: variants, and the effects of its requests."""

from __future__ import annotations

from dataclasses import replace

from verification.drive_variants import DriveVariant, FrameLengths
from verification.families.effect_names import effect_of_name
from verification.families.family_facts import FamilyFacts
from verification.reference.effects import ReferenceWrite, RequestEffect
from verification.reference.sunfar import OPERATIONS, SunfarReference

C320 = DriveVariant(
    name="c320-ascii",
    model="c320",
    encoding="ascii",
    baud=9600,
    frames=FrameLengths(request=18, reply=18, stop=15, delay_characters=8),
    gap_characters=5,
    min_timeout_s=0.0,
    min_timeout_characters=26,
    max_reply_lateness_s=0.18,
    broadcast=31,
    addresses=range(31),
    start_has_setpoint=True,
    undetected_swaps=(1, 10),
    lateness_range_s=(0.06, 0.15),
    plain_reply=(18, (0, 1, 2)),
)
"""2.2.2: 14 characters, with an operation 15, with a value 18; 8 characters to reply."""
C320_HEX = replace(C320, name="c320-hex", encoding="hex")
OPERATION_EFFECTS = {operation: effect_of_name(name) for operation, name in OPERATIONS.items()}
"""An operation acts in every class (T01, T07)."""
WITH_FREQUENCY = frozenset(operation for operation, name in OPERATIONS.items() if name.endswith("frequency"))
WRITES, SAVES, CONTROL = (3, 5), 5, 4
"""Classes (2.4.3)."""
STANDSTILL = (0x00, 0x03, 0x20, 0x21)
"""States (2.4.6): DC bus not ready, stopped, fault, emergency stop."""


def class_and_operation(variant: DriveVariant, frame: bytes) -> tuple[int, int]:
    """Return class and operation of a request (2.4.3, 2.4.4)."""
    kind, operation = SunfarReference(variant.encoding).parse_request(frame)[1:3]
    return kind, operation


class SunfarFacts(FamilyFacts):
    """Facts of the C320 in both encodings."""

    variants = (C320, C320_HEX)

    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        address, kind, operation, *_ = SunfarReference(encoding).parse_request(frame)
        effect = OPERATION_EFFECTS[operation]
        if effect is not RequestEffect.READ:
            return address, effect
        if kind == CONTROL:
            raise ValueError(f"class {kind}, operation {operation:02X}")
        return address, RequestEffect.SETTING if kind in WRITES else RequestEffect.READ

    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        kind, operation = SunfarReference("ascii").parse_request(frame)[1:3]
        effect = OPERATION_EFFECTS[operation]
        if effect is RequestEffect.READ and kind in (*WRITES, CONTROL):
            return RequestEffect.SETTING
        if effect is RequestEffect.STOP and (kind != CONTROL or operation in WITH_FREQUENCY):
            return RequestEffect.SETTING
        return effect

    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        _, kind, operation, *_, data = fields = SunfarReference(variant.encoding).parse_request(frame)
        if operation and kind != CONTROL:
            raise ValueError(f"class {kind} carries operation {operation:02X} (T01)")
        if kind in WRITES:
            group, item = fields[3:5]
            return ReferenceWrite(parameter=group << 8 | item, saved=kind == SAVES)
        return ReferenceWrite(hz=data / 100) if operation in WITH_FREQUENCY else ReferenceWrite()

    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request is of class 2 with a group."""
        _, kind, _, group, *_ = SunfarReference(variant.encoding).parse_request(frame)
        return kind == 2 and group != 0

    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        return request if class_and_operation(variant, request)[0] == 1 else None

    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        meaning = SunfarReference(variant.encoding).decode_reply(request, reply)
        return None if meaning is None or "state" not in meaning else meaning["state"] in STANDSTILL


FACTS = SunfarFacts()
