"""Frames a second in each direction for Sunfar, DZB100 and Modbus; RTU beside pymodbus' framer in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

from benchmarks.harness import Figures
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Codec

ROUNDS, FRAMES = 7, 5000


def seconds_each(work: Callable[[], object]) -> float:
    """Return the median seconds of one call."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(FRAMES):
            work()
        times.append((time.perf_counter() - start) / FRAMES)
    return median(times)


def cases() -> dict[str, tuple[Codec, Any, Any]]:
    """Return codec, request and reply of an ordinary read in each encoding."""
    values = (5000, 3998, 128, 3100)
    read, registers = modbus.ReadRegisters(1, 0x3001, 4), modbus.RegisterValues(1, 3, values)
    monitor = sunfar.ReadMonitor(3, 0)
    status = sunfar.SunfarReply(
        address=3, response=sunfar.SunfarResponse(0), state=sunfar.SunfarState(1), group=0, item=0, data=999
    )
    return {
        "c320 ascii": (sunfar.SunfarCodec("ascii"), monitor, status),
        "c320 hex": (sunfar.SunfarCodec("hex"), monitor, status),
        "dzb100": (
            dzb100.Dzb100Codec(),
            dzb100.Dzb100Query(7, 1),
            dzb100.Dzb100Reply(head="Q", address=7, index=1, data=100, accepted=True, digit=None),
        ),
        "modbus rtu": (modbus.ModbusRtuCodec(), read, registers),
        "modbus ascii": (modbus.ModbusAsciiCodec(), read, registers),
    }


def drivebus_rates() -> Figures:
    """Return frames a second in each direction; ``pair_us``: encode a request and decode its reply."""
    found: Figures = {}
    for name, (codec, request, reply) in cases().items():
        sent, received = codec.encode_request(request), codec.encode_reply(reply)
        times = {
            "encode_request": seconds_each(lambda c=codec, r=request: c.encode_request(r)),
            "decode_reply": seconds_each(lambda c=codec, r=request, h=received: c.decode_reply(r, h)),
            "decode_request": seconds_each(lambda c=codec, s=sent: c.decode_request(s)),
            "encode_reply": seconds_each(lambda c=codec, r=reply: c.encode_reply(r)),
        }
        pair = (times["encode_request"] + times["decode_reply"]) * 1e6
        found[name] = {way: round(1 / seconds) for way, seconds in times.items()} | {"pair_us": round(pair, 2)}
    return found


def pymodbus_pair_us() -> float:
    """Measure pymodbus' RTU framer: build a request and decode its reply."""
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU
    from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

    framer = FramerRTU(DecodePDU(False))
    codec, _, reply = cases()["modbus rtu"]
    received = codec.encode_reply(reply)

    def pair() -> None:
        framer.buildFrame(ReadHoldingRegistersRequest(address=0x3001, count=4, dev_id=1))
        _used, message = framer.handleFrame(received, 1, 0)
        assert message is not None

    return seconds_each(pair) * 1e6


def run_codecs() -> Figures:
    found = drivebus_rates()
    theirs = pymodbus_pair_us()
    ratio = found["modbus rtu"]["pair_us"] / theirs
    return {"frames_per_s": found, "pymodbus_rtu_pair_us": round(theirs, 2), "ratio_to_pymodbus": round(ratio, 3)}
