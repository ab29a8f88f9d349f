"""Facts of Mitsubishi's computer link: its variant, and the effects of its requests."""

from __future__ import annotations

from verification.drive_variants import NOT_YET_COVERED_BY, DriveVariant, FrameLengths
from verification.families.family_facts import FamilyFacts
from verification.reference.effects import ReferenceWrite, RequestEffect
from verification.reference.mitsubishi import FREQUENCY, READS, RUN, STATUS, MitsubishiReference

FR_E500 = DriveVariant(
    name="fr-e500",
    model="fr_e500",
    encoding="ascii",
    baud=9600,
    frames=FrameLengths(request=12, reply=10, stop=10, delay_s=0.1),
    gap_floor_s=0.01,
    min_timeout_characters=3,
    identical_probe_quarantine_s=5.0,
    numbers_faults=False,
    broadcast=None,
    stops_by_broadcast=False,
    status_read_count=2,
    undetected_swaps=(1, 3),
    plain_reply=(10, (1, 2)),
    not_covered_by=NOT_YET_COVERED_BY,
)
"""10 ms before the next request (FR-A720 manual, page 336); reply delay and lateness are assumed, as on its page. A
reply does not name its request: sync probes differ only in their number of digits."""
EFFECTS = {0x00: RequestEffect.STOP, 0x02: RequestEffect.MOTION, 0x04: RequestEffect.MOTION}
"""Data of FA: stop, forward, reverse (LinuxCNC mitsub_vfd.py)."""
TURNING = 0x06
"""Bits 1 and 2 of 7A: forward, reverse."""
HIGHEST_WORD = 40000
"""LinuxCNC mitsub_vfd.py sends no higher frequency."""


class MitsubishiFacts(FamilyFacts):
    """Facts of the computer link."""

    variants = (FR_E500,)

    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        station, code, data = MitsubishiReference().parse_request(frame)
        if code == RUN:
            if data not in EFFECTS:
                raise ValueError(f"run command {data:02X}")
            return station, EFFECTS[data]
        return station, RequestEffect.READ if code in READS else RequestEffect.SETTING

    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        """Return the effect; a waiting time other than the one that is sent counts as motion."""
        return self.classify(model, "ascii", frame)[1] if frame[5:6] == b"1" else RequestEffect.MOTION

    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        _, code, data = MitsubishiReference().parse_request(frame)
        if code == RUN:
            return ReferenceWrite()
        if data is None or data > HIGHEST_WORD:
            raise ValueError(f"frequency {data}")
        return ReferenceWrite(hz=data / 100)

    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request reads the status or the frequency."""
        return MitsubishiReference().parse_request(frame).code in (STATUS, FREQUENCY)

    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        return request if self.is_sync_probe(variant, request) else None

    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        value = MitsubishiReference().parse_reply(request, reply)
        if value is None or self.status_read_key(variant, request) is None:
            return None
        is_status = MitsubishiReference().parse_request(request).code == STATUS
        return not value & TURNING if is_status else value == 0


FACTS = MitsubishiFacts()
