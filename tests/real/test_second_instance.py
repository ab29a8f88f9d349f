"""A second program on the port is refused with the owner's pid; one on the wire is detected as a foreign master."""

from __future__ import annotations

import asyncio
import json
import os
import tempfile
import termios
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivebus.bus import Bus
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import StartInhibited
from drivebus.ports import open_port
from real.conftest import Start
from real.host_process import slow_machine_drive
from real.recorded_bench import PROCESS_TIMEOUT_S, RecordedPlant, c320, vc660, wait_until
from verification.reference.effects import RequestEffect

Plants = Callable[..., RecordedPlant]
FIRST_USER, SECOND_USER, ROOT = 65534, 65533, 0
TRIALS = 100


@pytest.fixture
def homes() -> Iterator[Callable[[int], dict[str, str]]]:
    """Return a function that makes state directories which the users can access."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)

        def home(user: int) -> dict[str, str]:
            path = Path(folder) / str(user)
            if not path.exists():
                path.mkdir()
                os.chown(path, user, user)
            return {"XDG_STATE_HOME": str(path)}

        yield home


def refusals(
    plant: RecordedPlant,
    started: Start,
    homes: Callable[[int], dict[str, str]],
    first: int,
    second: int,
    exclusive: int = 0,
) -> tuple[int, Counter[tuple[str, int]]]:
    """Return the owner's pid and the counted errors of the second program."""
    device = os.path.realpath(plant.path())
    owner = started("user_process.py", first, exclusive, "hold", device, env=homes(first))
    assert owner.stdout is not None and owner.stdout.readline() == "open\n"
    other = started("user_process.py", second, exclusive, TRIALS, device, env=homes(second))
    out, errors = other.communicate(timeout=PROCESS_TIMEOUT_S)
    assert other.returncode == 0, errors
    attempts = [json.loads(line) for line in out.splitlines()]
    assert all(str(owner.pid) in each["text"] for each in attempts if "text" in each)
    owner.kill()
    return owner.pid, Counter((each["key"], each.get("pid")) for each in attempts)


def test_a_second_instance_of_the_same_user_is_refused_100_times_of_100_with_the_owners_pid(
    plants: Plants, started: Start, homes: Callable[[int], dict[str, str]]
) -> None:
    me = os.getuid()
    pid, errors = refusals(plants(c320()), started, homes, me, me)
    assert errors == {("ports.held_drivebus", pid): TRIALS}


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be several users")
@pytest.mark.parametrize(
    ("first", "second", "exclusive"),
    [(FIRST_USER, SECOND_USER, 0), (FIRST_USER, SECOND_USER, 1), (ROOT, FIRST_USER, 0), (FIRST_USER, ROOT, 0)],
    ids=["another user", "another user, TIOCEXCL", "root was first", "root is second and takes the lock"],
)
def test_a_second_instance_of_another_user_is_refused_100_times_of_100_with_the_owners_pid(
    plants: Plants, started: Start, homes: Callable[[int], dict[str, str]], first: int, second: int, exclusive: int
) -> None:
    """The users cannot see each other's lock files or open files; the pid is from the kernel's list of locks."""
    pid, errors = refusals(plants(c320(format="8N1")), started, homes, first, second, exclusive)
    assert errors == {("ports.held", pid): TRIALS}


READS = {"c320": "2A 30 31 31 30 30 30 30 34 30 31 38 36 0D", "vc660": "01 03 30 06 00 01 6B 0B"}
SETS = {"c320": "2A 30 31 34 31 30 30 33 45 38 30 31 44 36 0D", "vc660": "01 06 20 01 01 F4 D3 DD"}
"""Reads of the DC bus voltage (d.4 and 3006H); writes of the setpoint: 10.00 Hz (operation 10H) and 5.00 Hz (2001H)."""


@pytest.mark.parametrize("model", ["c320", "vc660"])
@pytest.mark.parametrize("frames", [READS, SETS], ids=["reads", "writes"])
@pytest.mark.parametrize("adapter", [1, 0], ids=["another adapter", "the same port, which echoes"])
async def test_a_master_that_takes_no_lock_is_detected_by_its_second_frame_and_no_start_is_sent(
    plants: Plants, model: str, frames: dict[str, str], adapter: int
) -> None:
    """No port can refuse a program that takes no lock, on its own adapter or on ours."""
    more = {"keypad": {}, "line_quality": "clean" if adapter else "echo"}
    plant = plants(c320(**more) if model == "c320" else vc660(**more), adapters=2)
    async with Bus(open_port(plant.url(), echo="off" if adapter else "on")) as bus:
        drive = slow_machine_drive(bus, model)
        await drive.status()
        assert not bus.health(1).foreign_master
        other_master = os.open(plant.path(adapter=adapter), os.O_RDWR | os.O_NOCTTY)
        attributes = termios.tcgetattr(other_master)
        attributes[4] = attributes[5] = termios.B19200
        termios.tcsetattr(other_master, termios.TCSANOW, attributes)
        before = plant.requests()[-1].t
        data = bytes.fromhex(frames[model])
        for number in (1, 2):
            os.write(other_master, data)
            await eventually(lambda number=number: foreign(plant, data, before) == number)  # type: ignore[misc]
            await asyncio.sleep(0.3)
        await eventually(lambda: bus.health(1).foreign_master)
        assert [request.data for request in plant.requests(since=before)] == [data, data]
        with pytest.raises(StartInhibited) as caught:
            await drive.run(10.0)
        assert caught.value.key == "drives.foreign_master"
        assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
        os.close(other_master)
    plant.settle()
    ours = [request.effect for request in plant.requests() if request.data != data]
    assert RequestEffect.STOP in ours and RequestEffect.MOTION not in ours


def foreign(plant: RecordedPlant, data: bytes, since: float) -> int:
    return sum(request.data == data for request in plant.requests(since=since))


async def eventually(condition: Callable[[], bool]) -> None:
    """Wait for a condition like ``wait_until``, while the test's own loop runs."""
    async with asyncio.timeout(PROCESS_TIMEOUT_S):
        while not condition():  # noqa: ASYNC110  # another process' record
            await asyncio.sleep(0.02)


def test_the_lock_of_a_killed_owner_does_not_block_the_next(plants: Plants, started: Start) -> None:
    plant = plants(c320())
    words = (os.getuid(), 0, "hold", os.path.realpath(plant.path()))
    first = started("user_process.py", *words)
    assert first.stdout is not None and first.stdout.readline() == "open\n"
    first.kill()
    wait_until(lambda: first.poll() is not None, "its end")
    second = started("user_process.py", *words)
    assert second.stdout is not None and second.stdout.readline() == "open\n"
