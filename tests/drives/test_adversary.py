"""What somebody tried who wanted a motor to go on turning, or a stop to be lost or believed, when it must not."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore, OutcomeWord, bus_stop
from drivebus.drives.gate import FAILURES, Command, Evidence, Kind, grant
from drivebus.drives.lease import JogLease
from drivebus.drives.operation import PREPARE_S, Talk
from drivebus.drives.start import confirm
from drivebus.drives.state import DriveState, Outcome, Verdict
from drivebus.drives.talk import Surroundings
from drivebus.errors import DrivebusError, Expired, GateError, StopUnconfirmed
from drivebus.message import Effect, WriteClass
from drivebus.ports import open_port
from drivebus.protocols import sifang
from drivekit import MODELS, SAFE_HZ, Bench, PaperC320, World, dialect_of, story, talk_of

PROVED = {"df800": {"direction_proved": True}}
JOG_HZ = {"c320": 5.0, "dzb100": 0.5}


async def until_turning(bench: Bench, task: asyncio.Future[Any]) -> None:
    for _ in range(20000):
        if not bench.station().motor.energised and not task.done():
            await asyncio.sleep(0.0005)
    assert bench.station().motor.energised


async def jogging(drive: Any) -> None:
    async with drive.jog(JOG_HZ.get(drive.profile.model)) as lease:
        while True:
            await asyncio.sleep(0.1)
            lease.renew()


@pytest.mark.parametrize("begun_s", [0.0, 0.3])
@pytest.mark.parametrize("model", MODELS)
def test_t13_a_jog_whose_stop_is_lost_with_the_adapter_ends_when_the_adapter_is_back(
    model: str, begun_s: float
) -> None:
    """At once after the jog frame, and later: somebody must go on telling it to stop (matrix: forever)."""

    async def told() -> None:
        async with Bench(model) as bench:
            drive = bench.drive(settings=PROVED.get(model))
            await drive.status()
            task = asyncio.ensure_future(jogging(drive))
            await until_turning(bench, task)
            await asyncio.sleep(begun_s)
            bench.port.bench.unplug()
            await asyncio.sleep(0.6)
            task.cancel()
            with pytest.raises((DrivebusError, asyncio.CancelledError)):
                await task
            assert drive.stop_pending
            bench.port.bench.replug()
            await asyncio.sleep(10.0)
            assert not bench.station().motor.energised
            await asyncio.sleep(5.0)
            assert not drive.stop_pending

    story(told())


def test_a_proof_run_that_is_cancelled_is_stopped() -> None:
    async def told() -> None:
        async with Bench("dzb100") as bench:
            drive = bench.drive(settings={"query_coding": "hex-0.1"})
            task = asyncio.ensure_future(drive.prove_setpoint_coding())
            await until_turning(bench, task)
            await asyncio.sleep(1.0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await asyncio.sleep(15.0)
            assert not bench.station().motor.energised and not drive.stop_pending

    story(told())


@pytest.mark.parametrize("patience_s", [0.0005, 0.02, 0.2])
@pytest.mark.parametrize("model", MODELS)
def test_a_stop_whose_caller_gave_up_waiting_goes_on(model: str, patience_s: float) -> None:
    """``wait_for(drive.stop(), …)``: the caller is told late, the motor is stopped all the same."""

    async def told() -> None:
        async with Bench(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model])
            await asyncio.sleep(1.0)
            busy = asyncio.ensure_future(drive.status())
            await asyncio.sleep(0.001)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(drive.stop(), patience_s)
            busy.cancel()
            bench.port.bench.unplug()
            await asyncio.sleep(0.01)
            bench.port.bench.replug()
            await asyncio.sleep(40.0)
            assert not bench.station().motor.energised

    story(told())


def test_an_unconfirmed_stop_is_not_repeated_on_a_bus_that_was_closed() -> None:
    async def told() -> set[asyncio.Task[Any]]:
        async with Bench("c320") as bench:
            drive = bench.drive()
            await drive.status()
            bench.port.bench.unplug()
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            assert drive.stop_pending
        await asyncio.sleep(10.0)
        return asyncio.all_tasks() - {asyncio.current_task()}  # type: ignore[arg-type]

    assert not story(told())


def test_a_bus_stop_with_a_drive_that_left_the_bus_stops_the_others_and_says_so() -> None:
    async def told() -> None:
        async with Bench("c320", "1-3") as bench:
            drives = [bench.drive(address) for address in (1, 2, 3)]
            for drive in drives:
                await drive.run(20.0)
            bench.bus.remove(2)
            report = await bus_stop(bench.bus, drives)
            assert report.unconfirmed == (2,) and not report.confirmed
            assert not any(bench.station(address).motor.energised for address in (1, 3))

    story(told())


@pytest.mark.parametrize(("model", "query"), [("c320", "baud=1200"), ("dzb100", "baud=1200"), ("vc660", "baud=1200")])
def test_t13_a_lease_counts_from_the_moment_at_which_the_motor_may_turn(model: str, query: str) -> None:
    """Not from the drive's answer, which takes a quarter of a second at 1,200 baud."""

    async def told() -> None:
        async with Bench(model, query=query) as bench:
            drive = bench.drive()
            await drive.preflight()
            frames: list[tuple[float, Effect]] = []
            bench.bus.trace(
                lambda event: (
                    frames.append((event.time, drive.dialect.link.effect(event.data)))
                    if event.direction == "sent"
                    else None
                )
            )
            lease = drive.jog(JOG_HZ.get(model))
            async with lease:
                await asyncio.sleep(5.0)
            assert lease.lost
            moved = next(at for at, effect in frames if effect is Effect.MOTION)
            stopped = next(at for at, effect in frames if effect is Effect.STOP)
            longest_frame_s = 14 * 11 / 1200
            assert 0.5 <= stopped - moved <= 0.5 + 2 * longest_frame_s

    story(told())


class Renumbered:
    """A serial port before and after it was opened: only then it knows which adapter it is."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self.identity = "device:/dev/ttyUSB0"
        self.url = "/dev/ttyUSB0"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    async def open(self, receiver: Any) -> None:
        await self._port.open(receiver)
        self.identity = "usb:0403:6001:B"


def test_t08_what_was_proved_behind_a_device_name_is_not_believed_behind_another_adapter() -> None:
    """A drive made before its bus is opened: the proofs and the wear are those of the adapter that is opened."""

    async def told() -> None:
        store = MemoryStore()
        store.put("proof/device:/dev/ttyUSB0/1/dzb100/setpoint_coding", '"hex-1"')
        store.put("proof/usb:0403:6001:B/1/dzb100/query_coding", '"hex-0.1"')
        port: Any = Renumbered(open_port("sim://dzb100@1"))
        bus = Bus(port)
        drive = Drive(bus, "dzb100", 1, store=store)
        assert "hex-1" not in drive.dialect.settings.values()
        await bus.open()
        await drive.status()
        assert drive.dialect.settings["setpoint_coding"] == "unknown"
        assert drive.dialect.settings["query_coding"] == "hex-0.1"
        await drive.write({"10": 12.0}, save=True)
        assert store.get("wear/usb:0403:6001:B/1/10") and not store.get("wear/device:/dev/ttyUSB0/1/10")
        await bus.close()

    story(told())


def test_t13_a_lease_that_is_over_before_the_answer_came_is_lost_at_once() -> None:
    async def done() -> Outcome:
        return Outcome(OutcomeWord.CONFIRMED, "drives.stop_confirmed")

    async def told() -> None:
        async with JogLease(done, done, 0.5, lambda: 0.7) as lease:
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            assert lease.lost

    story(told())


@pytest.mark.parametrize(
    "state", [sifang.State.JOGGING_FORWARD, sifang.State.DC_BRAKING, sifang.State.DECELERATING_FORWARD]
)
def test_ruling_1_a_start_is_not_confirmed_by_a_drive_that_does_something_else(state: sifang.State) -> None:
    """Somebody jogs at the keypad, it brakes, or it ramps down: nobody may read "started"."""
    world = World(dialect_of("c320"), PaperC320(state))
    talk = talk_of(world.dialect)
    command = talk.memory.command(Kind.START, Surroundings(0.0))
    outcome = world.play(confirm(talk, command, world.dialect.start(None, 2000), None, True))
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.start_unknown")
    assert outcome.status is not None and outcome.status.state in {
        DriveState.JOGGING, DriveState.BRAKING, DriveState.DECELERATING
    }  # fmt: skip
    assert not world.effects()


@pytest.mark.parametrize(("failures", "blocked"), [(FAILURES - 1, False), (FAILURES, True)])
def test_three_spoiled_replies_make_a_bad_link_and_two_do_not(failures: int, blocked: bool) -> None:
    around = Surroundings(10.5, generation=3, error_rate=0.5, failures=failures)
    stands = Evidence(Verdict(DriveState.STOPPED), 10.4, can_tell=True, preflight_done=True, within_limits=True)
    wish = Command("start-1", Kind.START, 10.0, 3)
    with pytest.raises(GateError) if blocked else contextlib.nullcontext():
        grant(wish, 7, Effect.MOTION, WriteClass.EDGE, around, stands, "sifang")


@pytest.mark.parametrize(("age_s", "fits"), [(PREPARE_S, True), (PREPARE_S + 0.01, False)])
def test_i1_checks_that_took_too_long_make_it_another_wish(age_s: float, fits: bool) -> None:
    """The command's own two seconds begin only after them."""
    world = World(dialect_of("c320"), PaperC320(), around=Surroundings(100.0 + age_s))
    talk = Talk(talk_of(world.dialect).memory, 0, 100.0)
    with contextlib.nullcontext() if fits else pytest.raises(Expired):
        world.play(talk.in_time())


def test_a_stop_since_the_wish_takes_the_command_away_before_it_is_made() -> None:
    """6.5: it was wished for before the stop, whenever its turn came."""
    world = World(dialect_of("c320"), PaperC320())
    memory = talk_of(world.dialect).memory
    stopped = Surroundings(1.0, generation=4)
    assert Talk(memory, 3).command(Kind.START, stopped).generation == 3
    assert Talk(memory).command(Kind.START, stopped).generation == 4


def word_of(dialect: Any, *names: str) -> int:
    bits = dialect.word.map.bits
    return int(sum(bits[name].value for name in names))


def test_a_reset_that_also_turns_the_direction_level_may_move() -> None:
    """VC660: a reset repeats the levels that the drive holds, or it is no mere reset."""
    dialect: Any = dialect_of("vc660")
    assert dialect.word.effect(word_of(dialect, "reset")) is Effect.SETTING
    assert dialect.word.effect(word_of(dialect, "reset", "reverse")) is Effect.MOTION
    dialect.word.sent(word_of(dialect, "start", "reverse"))
    assert dialect.word.effect(word_of(dialect, "reset", "reverse")) is Effect.SETTING
    assert dialect.word.effect(word_of(dialect, "reset")) is Effect.MOTION


def test_a_stop_of_df800_with_a_direction_in_it_is_no_stop() -> None:
    """It has no levels to keep: a direction is an order of its own, and needs leave."""
    dialect: Any = dialect_of("df800", direction_proved=True)
    assert dialect.word.effect(word_of(dialect, "stop")) is Effect.STOP
    assert dialect.word.effect(word_of(dialect, "stop", "reverse")) is Effect.MOTION


@pytest.mark.parametrize("command", ["reset_fault", "write"])
def test_a_command_that_waited_its_turn_for_too_long_is_another_wish(command: str) -> None:
    async def told() -> None:
        async with Bench("c320") as bench:
            drive = bench.drive()
            async with drive._lock:
                wish = drive.reset_fault() if command == "reset_fault" else drive.write({"F0.2": 20.0})
                waiting = asyncio.ensure_future(wish)
                await asyncio.sleep(PREPARE_S + 0.01)
            with pytest.raises(Expired) as caught:
                await waiting
            assert caught.value.key == "drives.turn_too_late"

    story(told())
