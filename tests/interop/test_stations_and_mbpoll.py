"""Our simulated VC660 and DF800 answer mbpoll, another project's master, over a pty."""

from __future__ import annotations

import sys

import pytest

from drivebus.simulator.bus import SimulatedBus
from fixtures.station_bench import ProgramResult, quick_bench, run_program, serve_on_pty, wait_until
from peers import need_program

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ptys as Linux has them")

COMMAND, SETPOINT, STATUS, DC_BUS = 0x2000, 0x2001, 0x3000, 0x3006
READY, RUNNING = 1, 8
"""Bits of 3000H (VC660 guide, section 5)."""


def turns_at(made: SimulatedBus, hz: float) -> bool:
    return made.station(1).motor.output_hz == pytest.approx(hz, abs=0.004)


async def mbpoll(
    path: str,
    register: int,
    *values: int,
    station: str = "1",
    count: int = 1,
    table: str = "4",
    timeout_s: float = 2.0,
) -> ProgramResult:
    """Run mbpoll once, with register numbers as on the wire."""
    return await run_program(
        need_program("mbpoll", "mbpoll"),
        "-m",
        "rtu",
        "-b",
        19200,
        "-P",
        "none",
        "-0",
        "-1",
        "-o",
        timeout_s,
        "-a",
        station,
        "-t",
        table,
        "-r",
        register,
        *(() if values else ("-c", count)),
        path,
        *values,
    )


async def test_mbpoll_starts_a_vc660_reads_its_status_and_stops_it() -> None:
    made = quick_bench("vc660@1")
    motor = made.station(1).motor
    async with serve_on_pty(made) as path:
        assert (await mbpoll(path, STATUS, count=2)).registers == {STATUS: READY, STATUS + 1: 0}
        assert (await mbpoll(path, SETPOINT, 3000)).code == 0
        assert not motor.energised, "a set frequency alone starts nothing"
        assert "Written 1 references" in (await mbpoll(path, COMMAND, 1)).text
        await wait_until(lambda: turns_at(made, 30.0), "30 Hz")
        assert motor.energised and motor.starts == 1
        seen = (await mbpoll(path, STATUS, count=4)).registers
        assert seen[STATUS] == READY | RUNNING
        assert (seen[STATUS + 1], seen[STATUS + 2]) == (3000, 3000)
        assert seen[STATUS + 3] == round(motor.current_a * 10) > 0
        assert (await mbpoll(path, DC_BUS)).registers[DC_BUS] == pytest.approx(motor.bus_v, abs=2)
        assert (await mbpoll(path, COMMAND, 2)).code == 0
        await wait_until(lambda: not made.station(1).running, "standstill")
        assert (await mbpoll(path, STATUS)).registers == {STATUS: READY}


async def test_mbpoll_runs_a_vc660_backwards() -> None:
    """The direction is a level of the command word: 5 is start and reverse."""
    made = quick_bench("vc660@1")
    async with serve_on_pty(made) as path:
        await mbpoll(path, SETPOINT, 1000)
        await mbpoll(path, COMMAND, 5)
        await wait_until(lambda: turns_at(made, -10.0), "10 Hz backwards")
        seen = (await mbpoll(path, STATUS, count=3)).registers
        assert seen[STATUS] == READY | RUNNING | 0xC000
        assert seen[STATUS + 2] == 1000


async def test_mbpoll_writes_a_parameter_to_ram_or_with_its_top_bit_to_eeprom() -> None:
    made = quick_bench("vc660@1")
    memory = made.station(1).memory
    async with serve_on_pty(made) as path:
        assert (await mbpoll(path, 2, 4500)).code == 0
        assert (memory.ram[2], memory.eeprom[2]) == (4500, 5000)
        assert (await mbpoll(path, 0x8000 | 2, 4400)).code == 0
        assert (memory.ram[2], memory.eeprom[2]) == (4400, 4400)
        assert (await mbpoll(path, 0, count=4)).registers == {0: 5000, 1: 4, 2: 4400, 3: 0}


async def test_mbpoll_polls_two_vc660_in_turn_and_gets_no_reply_from_a_third() -> None:
    made = quick_bench("vc660@1,2")
    async with serve_on_pty(made) as path:
        reply_text = await mbpoll(path, STATUS, station="1,2")
        assert (reply_text.code, reply_text.text.count(f"[{STATUS}]: \t1")) == (0, 2)
        no_user = await mbpoll(path, STATUS, station="3", timeout_s=0.2)
        assert (no_user.code, no_user.registers) == (1, {})
        assert "Connection timed out" in no_user.text


@pytest.mark.parametrize(
    ("register", "values", "count", "table", "exception"),
    [
        (STATUS, (), 1, "3", "Illegal function"),  # 04
        (0, (), 1, "0", "Illegal function"),  # 01
        (SETPOINT, (1000, 1000), 1, "4", "Illegal function"),  # 10H
        (0x200B, (), 1, "4", "Illegal data address"),  # in no table (T12)
        (COMMAND, (), 1, "4", "Illegal data address"),  # write-only
        (STATUS + 0x17, (), 3, "4", "Illegal data address"),  # begins inside, ends outside
        (0x1C3, (7,), 1, "4", "Illegal data address"),  # one past the last parameter
        (STATUS, (), 5, "4", "Illegal data value"),  # four words at most
        (SETPOINT, (40001,), 1, "4", "Illegal data value"),
    ],
)
async def test_mbpoll_shows_the_vc660s_exception(
    register: int, values: tuple[int, ...], count: int, table: str, exception: str
) -> None:
    async with serve_on_pty(quick_bench("vc660@1")) as path:
        reply_text = await mbpoll(path, register, *values, count=count, table=table)
    assert (reply_text.code, reply_text.registers) == (1, {})
    assert f"failed: {exception}" in reply_text.text


async def test_mbpoll_shows_that_a_running_vc660_refuses_to_change_its_command_source() -> None:
    """The drive answers exception 4, the guide's code for a request that cannot be executed now."""
    made = quick_bench("vc660@1")
    station = made.station(1)
    source = 30  # F01.00 of the simulated drive
    async with serve_on_pty(made) as path:
        station.keypad_run(10.0)
        reply_text = await mbpoll(path, source, 0)
        assert reply_text.code == 1 and "Slave device or server failure" in reply_text.text
        assert station.memory[source] == 2
        station.keypad_stop()
        await wait_until(lambda: not made.station(1).running, "standstill")
        assert (await mbpoll(path, source, 0)).code == 0
        assert station.memory[source] == 0


async def test_mbpoll_starts_and_stops_a_df800() -> None:
    made = quick_bench("df800@1")
    motor = made.station(1).motor
    async with serve_on_pty(made) as path:
        assert (await mbpoll(path, 100, count=3)).registers == {100: 5000, 101: 5, 102: 2}
        assert (await mbpoll(path, SETPOINT, 2500)).code == 0
        assert (await mbpoll(path, COMMAND, 2)).code == 0
        await wait_until(lambda: turns_at(made, 25.0), "25 Hz")
        seen = (await mbpoll(path, 3, count=3)).registers
        assert seen == {3: round(motor.current_a * 10), 4: round(motor.bus_v), 5: round(motor.speed_rpm)}
        assert (await mbpoll(path, COMMAND, 1)).code == 0
        await wait_until(lambda: not made.station(1).running, "standstill")


async def test_mbpoll_does_not_recognize_the_df800s_short_error_as_an_exception() -> None:
    """T15: the error has five bytes and an unchanged function, so a read ends as bad data and a write in a timeout."""
    made = quick_bench("df800@1")
    async with serve_on_pty(made) as path:
        refused = await mbpoll(path, 100, count=5)
        assert refused.code == 1 and "Invalid data" in refused.text
        unanswered = await mbpoll(path, 3, 1, timeout_s=0.2)
        assert unanswered.code == 1 and "Connection timed out" in unanswered.text
        assert made.station(1).reply_count == 2, "both were answered"
