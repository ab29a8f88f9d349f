"""Steps that only read: port, owner, line, reply times, fences, parity."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from drivebus.errors import DrivebusError
from drivebus.message import Ask

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.connect import Target
    from drivebus.drives import Drive
    from drivebus.lab.hardware.rig import Rig

Found = tuple[bool | None, dict[str, Any]]
READS = 300
PARITY_READS = 20
MOST_FAILED = 0.01
"""A line on which more than 1 % of the reads fail, before their retry, is not well wired."""
LISTEN_S = 3.0
OTHER_PARITY = {"N": "E", "E": "O", "O": "E"}
STRAY = ("late", "foreign", "duplicate", "unsolicited", "master", "collision", "marks")
"""Counters that stay at zero on a line that is well wired and has one master."""


async def port(rig: Rig) -> Found:
    """What the port says of itself: real pacing, real parity, who switches the RS485 driver."""
    async with rig.drive() as (bus, _):
        able = bus.port.capabilities
        return True, {
            "identity": bus.port.identity, "line": str(bus.line), "paced": able.paced, "parity": able.parity,
            "direction_control": able.direction_control,
        }  # fmt: skip


async def owner(rig: Rig) -> Found:
    """G18: while we have the port no other program gets it."""
    if rig.target.link.startswith(("sim:", "memory:", "tcp:", "rfc2217:")):
        return None, {}
    async with rig.drive():
        error = (await rig.race(_another_program(rig.target))).get("error", {})
    return error.get("type") == "PortUnavailable", {"refused": error["text"]} if error else {}


async def _another_program(target: Target) -> dict[str, Any]:
    """What a second drivebus is told that reads the status of this drive."""
    options = ["--model", target.model, "--address", str(target.address), "--json", "--lang", "en"]
    options += [] if target.baud is None else ["--baud", str(target.baud)]
    options += [] if target.format is None else ["--format", target.format]
    program = await asyncio.create_subprocess_exec(
        sys.executable, "-c", "from drivebus.cli import main; main()", "status", target.link, *options,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    said, _ = await program.communicate()
    told: dict[str, Any] = json.loads(said.splitlines()[-1])
    return told


async def quiet(rig: Rig) -> Found:
    """F14: nobody speaks on the line while we don't."""
    async with rig.drive() as (bus, _):
        await rig.race(asyncio.sleep(LISTEN_S))
        heard = bus.statistics().bytes_received
    return heard == 0, {"listened_s": LISTEN_S, "bytes_heard": heard}


async def answers(rig: Rig) -> Found:
    """300 reads: reply times against what the line's arithmetic asks for, and what went wrong."""
    async with rig.drive() as (bus, drive):
        await rig.race(_reads(bus, drive, READS))
        found = bus.statistics().stations[drive.address]
    figures: dict[str, Any] = {
        f"reply_{name}_ms": _ms(getattr(found, f"reply_{name}_s")) for name in ("p50", "p95", "p99")
    }
    figures |= {"reads": found.transactions, "damaged": found.damaged, "errors": dict(found.errors)}
    figures["least_possible_ms"] = _ms(_least_s(bus, drive))
    return found.error_rate <= MOST_FAILED and found.replies >= READS, figures


async def fences(rig: Rig) -> Found:
    """F01, F02, F15: no late, foreign or second answer turned up in as many reads again."""
    async with rig.drive() as (bus, drive):
        await rig.race(_reads(bus, drive, READS))
        found = bus.statistics().counters
    stray = {name: found.get(name, 0) for name in STRAY}
    return not any(stray.values()), stray


async def parity(rig: Rig) -> Found:
    """G20: on a line with another parity than the drive's no value is believed. Only where parity is really checked."""
    async with rig.drive() as (bus, _):
        settings, real = bus.line, bus.port.capabilities.parity
    if not real or rig.target.link.startswith("sim:"):
        return None, {}
    other = f"{settings.data_bits}{OTHER_PARITY[settings.parity]}{settings.stop_bits}"
    async with replace(rig, target=replace(rig.target, format=other)).drive() as (bus, drive):
        await rig.race(_reads(bus, drive, PARITY_READS))
        found = bus.statistics().stations[drive.address]
    return found.replies == 0, {"format": other, "reads": PARITY_READS, "believed": found.replies}


async def _reads(bus: Bus, drive: Drive, count: int) -> None:
    for _ in range(count):
        await bus.transact(Ask(drive.address, drive.dialect.plain_read()))


def _least_s(bus: Bus, drive: Drive) -> float:
    """The reply's own characters: a drive and an adapter without any delay."""
    return bus.line.seconds(drive.dialect.codec.reply_size(drive.dialect.plain_read()))


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(1000 * seconds, 3)


async def answering(bus: Bus, drive: Drive) -> bool:
    """Does the drive answer now?"""
    try:
        return (await bus.transact(Ask(drive.address, drive.dialect.plain_read()))).error is None
    except DrivebusError:
        return False
