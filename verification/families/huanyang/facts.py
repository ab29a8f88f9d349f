"""Facts of the Huanyang HY: its variant, and the effects of its requests."""

from __future__ import annotations

from verification.drive_variants import NOT_YET_COVERED_BY, DriveVariant, FrameLengths
from verification.families.family_facts import FamilyFacts
from verification.reference.effects import ReferenceWrite, RequestEffect
from verification.reference.huanyang import CONTROL, FREQUENCY, READ, STATUS, HuanyangReference

HUANYANG_HY = DriveVariant(
    name="huanyang-hy",
    model="huanyang_hy",
    encoding="rtu",
    baud=9600,
    frames=FrameLengths(request=8, reply=8, stop=6, delay_s=0.1),
    gap_floor_s=0.05,
    min_timeout_characters=6,
    reports_faults=False,
    setpoint_readable=True,
    plain_reply=(8, (0, 1)),
    not_covered_by=NOT_YET_COVERED_BY,
)
"""50 ms of silence between frames (Dema D5M manual, page 68); reply delay and lateness are assumed, as on its page."""
EFFECTS = {0x01: RequestEffect.MOTION, 0x11: RequestEffect.MOTION, 0x08: RequestEffect.STOP}
"""Control byte: forward, reverse, stop (FluidNC Huanyang.cpp, LinuxCNC hy_vfd.c)."""
OUTPUT_FREQUENCY = 1


class HuanyangFacts(FamilyFacts):
    """Facts of the HY series."""

    variants = (HUANYANG_HY,)

    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        fields = HuanyangReference().parse_request(frame)
        if fields.function == CONTROL:
            if fields.value not in EFFECTS:
                raise ValueError(f"control {fields.value:02X}")
            return fields.address, EFFECTS[fields.value]
        reads = fields.function in (READ, STATUS)
        return fields.address, RequestEffect.READ if reads else RequestEffect.SETTING

    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        fields = HuanyangReference().parse_request(frame)
        odd_read = fields.function == READ and fields.value
        if odd_read or (fields.function == STATUS and len(fields.data) > 1) or self._is_broadcast_read(frame):
            return RequestEffect.MOTION
        return self.classify(model, "rtu", frame)[1]

    @staticmethod
    def _is_broadcast_read(frame: bytes) -> bool:
        return frame[0] == 0 and frame[1] in (READ, STATUS)

    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        fields = HuanyangReference().parse_request(frame)
        if fields.function == CONTROL:
            return ReferenceWrite()
        if fields.function == FREQUENCY:
            return ReferenceWrite(hz=fields.value / 100)
        return ReferenceWrite(parameter=fields.data[0], saved=True)

    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request reads a parameter."""
        return HuanyangReference().parse_request(frame).function == READ

    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        fields = HuanyangReference().parse_request(request)
        return request if fields.function == STATUS and fields.data[0] == OUTPUT_FREQUENCY else None

    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        """Return whether the output frequency is 0 Hz: no reply of this protocol shows more."""
        fields = HuanyangReference().parse_reply(request, reply)
        return None if fields is None or self.status_read_key(variant, request) is None else fields.value == 0


FACTS = HuanyangFacts()
