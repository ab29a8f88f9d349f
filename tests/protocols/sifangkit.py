"""What the C320 tests share: codecs, strategies of messages, and a reply that is believed."""

from __future__ import annotations

from typing import Any, Literal

from hypothesis import strategies as st

from drivebus.message import Complete
from drivebus.protocols import sifang
from drivebus.protocols.sifang import Operation, Reply, SifangCodec, State
from drivebus.protocols.sifang.frame import AsciiForm, PackedForm

Encoding = Literal["ascii", "hex"]
ENCODINGS: tuple[Encoding, ...] = ("ascii", "hex")
CODECS = {encoding: SifangCodec(encoding) for encoding in ENCODINGS}
FORMS = {"ascii": AsciiForm(bytes(range(256))), "hex": PackedForm()}
STOPS = (Operation.STOP, Operation.JOG_STOP, Operation.EMERGENCY_STOP)

encodings = st.sampled_from(ENCODINGS)
addresses, groups, items, words = st.integers(0, 30), st.integers(0, 15), st.integers(0, 255), st.integers(0, 0xFFFF)
reads = st.one_of(
    st.builds(sifang.ReadIdentity, addresses, groups),
    st.builds(sifang.ReadMonitor, addresses, items),
    st.builds(sifang.ReadParameter, addresses, groups, items),
)
writes = st.builds(sifang.WriteParameter, st.integers(0, 31), groups, items, words, st.booleans())
with_frequency = st.sampled_from([operation for operation in Operation if operation.sets_frequency])
without = st.sampled_from([operation for operation in Operation if not operation.sets_frequency])
controls = st.builds(sifang.Control, st.integers(0, 31), with_frequency, words) | st.builds(
    sifang.Control, st.integers(0, 31), without
)
requests = st.one_of(reads, writes, controls)
states = st.sampled_from([state for state in State if state is not State.FAULT])


reads_one = sifang.ReadMonitor(5, 0)


def accepted(request: sifang.Request, data: bytes, encoding: Encoding = "ascii", **options: Any) -> Reply:
    verdict = SifangCodec(encoding, **options).decode_reply(request, data)
    assert isinstance(verdict, Complete)
    reply: Reply = verdict.message
    return reply
