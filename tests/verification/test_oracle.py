"""The oracle finds a planted violation of each invariant (I9: the campaign ``failures``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from typing import Any

import pytest

from drivebus.bus.core import BusCore
from drivebus.bus.messages import Permit
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.station import Station, UnansweredRequest
from drivebus.bus.transaction import Transaction
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import get_bus_conditions
from drivebus.drives.permissives import PermitInputs
from drivebus.drives.state import DriveStatus
from drivebus.testing.virtual_time import running
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.campaigns import campaign_of
from verification.families.dzb100.facts import DZB100
from verification.families.modbus.facts import DF800, VC660
from verification.families.registry import DRIVE_VARIANTS
from verification.families.sunfar.facts import C320, C320_HEX
from verification.fault_injection.clocks import JumpingWallClock, before_midnight, installed_clock
from verification.reference.effects import ReferenceWrite, RequestEffect
from verification.reference.modbus import ModbusReference
from verification.reference.request_effects import classify_request, decode_write
from verification.reference.sunfar import SunfarReference
from verification.scenario.rules import ClassifiedFrame, FrameRules
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand


@pytest.fixture
def campaign_run() -> CampaignRun:
    return CampaignRun(campaign="test", seed=1, budget=1)


def make_scenario(
    campaign_run: CampaignRun, variant: DriveVariant = VC660, addresses: Any = (1, 2), **options: Any
) -> Scenario:
    return Scenario(campaign_run, variant, addresses, **options)


def found(campaign_run: CampaignRun, invariant: str) -> bool:
    return any(f": {invariant} " in text for text in campaign_run.violations)


def test_no_task_is_left_where_a_scenario_closes_during_a_run_after_an_unconfirmed_stop(
    campaign_run: CampaignRun,
) -> None:
    """The cancelled run let the stop be repeated on the closed bus: "Task was destroyed but it is pending"."""
    scenario = make_scenario(campaign_run, line_quality="loss=0.9")
    scenario.command(1, "stop")
    scenario.run(5.0)
    scenario.command(1, "run", 12.0)
    scenario.run(0.2)
    scenario.close()
    assert [task for task in scenario.loop.tasks if not task.done()] == []


@pytest.mark.parametrize("variant", DRIVE_VARIANTS, ids=lambda variant: variant.name)
def test_the_product_has_no_violation_and_a_trace(campaign_run: CampaignRun, variant: DriveVariant) -> None:
    trial: list[str] = []
    campaign_run.listener = trial.append
    scenario = make_scenario(campaign_run, variant, line_quality="lossy")
    scenario.monitor(1)
    run = scenario.command(1, "run", 12.0)
    scenario.finish(run)
    stop = scenario.command(1, "stop")
    scenario.finish(stop)
    scenario.close()
    assert campaign_run.violations == []
    assert scenario.oracle.accepted_count > 5
    assert any(" > 1 move " in line for line in trial) or run.result_word not in ("confirmed", "acknowledged")
    assert stop.result_word in (("confirmed", "unknown") if variant.reports_running else ("acknowledged", "unknown"))


def test_a_remembered_command_keeps_no_traceback(campaign_run: CampaignRun) -> None:
    """The traceback of its error would keep the whole operation in memory."""
    scenario = make_scenario(campaign_run)
    scenario.station(1).faults.silent = True
    stop = scenario.command(1, "stop")
    assert stop.task is not None
    scenario.finish(stop)
    scenario.close()
    assert stop.result_word == "unknown" and stop.task is None
    assert stop.error is not None and stop.error.__traceback__ is stop.error.__cause__ is stop.error.__context__ is None


def test_i1_a_motion_without_a_command_is_found(campaign_run: CampaignRun) -> None:
    scenario = make_scenario(campaign_run)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    scenario.loop.run_until_complete(scenario.drives[1].run(12.0))
    assert found(campaign_run, "I1")


def test_i1_a_motion_after_a_newer_stop_is_found(campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest.permit_error", lambda job, now: None)
    monkeypatch.setattr(Scheduler, "supersede", lambda scheduler, stations: [])
    monkeypatch.setattr(OperationContext, "check_not_superseded", _always)
    monkeypatch.setattr("drivebus.drives.permissives.grant_permit", _granted)
    for instant in range(60):
        scenario = make_scenario(campaign_run, C320)
        run = scenario.command(1, "run", 12.0)
        scenario.run(0.02 * instant)
        scenario.finish(scenario.command(1, "stop"), run)
        scenario.close()
    assert found(campaign_run, "I1")


def _always(op: OperationContext, command: Any) -> Any:
    return (yield from get_bus_conditions()).now


def _granted(inputs: PermitInputs) -> Permit:
    return Permit(
        station=inputs.station,
        effect=inputs.effect,
        retry_policy=inputs.retry_policy,
        expires_at=inputs.conditions.now + 2.0,
        stop_epoch=inputs.conditions.stop_epoch,
    )


@pytest.mark.parametrize("variant", [DZB100, DF800], ids=lambda variant: variant.name)
def test_i2_a_start_that_is_sent_again_blindly_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch, variant: DriveVariant
) -> None:
    """The second start is found where the motor is on and nothing changes, too."""
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest._max_write_attempts", lambda job: 3)
    scenario = make_scenario(campaign_run, variant)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    run = scenario.command(1, "run", 12.0)
    while 1 not in scenario.oracle.frame_rules._started:
        scenario.run(0.005)
    scenario.station(1).faults.mute = True
    scenario.run(0.3)
    scenario.station(1).faults.mute = False
    scenario.finish(run)
    assert found(campaign_run, "I2")


def test_i3_a_stop_that_waits_for_others_is_found(campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Scheduler.next

    def late(scheduler: Scheduler, now: float) -> Any:
        """Return polls before stops."""
        lanes = scheduler.queues
        scheduler.queues = (type(lanes[0])(), *lanes[1:])
        job = plain(scheduler, now)
        scheduler.queues = lanes
        return job or plain(scheduler, now)

    monkeypatch.setattr(Scheduler, "next", late)
    scenario = make_scenario(campaign_run, VC660, range(1, 9))
    for address in scenario.drives:
        scenario.monitor(address)
    scenario.run(1.0)
    scenario.finish(scenario.command(1, "stop"))
    assert found(campaign_run, "I3")


@pytest.mark.parametrize(
    ("target", "replacement"),
    [
        ("drivebus.drives.readings.ReadingPairs.with_staleness", lambda pairs, *_: pairs.latest),
        ("drivebus.values.Reading.age_s", lambda reading, now: 0.0),
    ],
    ids=["good-for-ever", "calls-itself-new"],
)
def test_i4_a_silent_drive_whose_values_stay_good_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch, target: str, replacement: Callable[..., object]
) -> None:
    """The oracle computes ages itself."""
    monkeypatch.setattr(target, replacement)
    scenario = make_scenario(campaign_run)
    scenario.monitor(1)
    scenario.run(5.0)
    scenario.station(1).faults.silent = True
    scenario.run(120.0)
    assert found(campaign_run, "I4")


def test_i4_a_reading_whose_time_is_moved_is_found(campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = make_scenario(campaign_run)
    monitor = scenario.monitor(1)
    scenario.run(5.0)
    scenario.station(1).faults.silent = True
    status, now = monitor.status(), scenario.loop.time
    monkeypatch.setattr(monitor, "status", lambda: _refreshed(status, now()))
    scenario.run(120.0)
    assert found(campaign_run, "I4")


def _refreshed(status: DriveStatus, now: float) -> DriveStatus:
    return replace(
        status, readings={name: replace(reading, source_time=now) for name, reading in status.readings.items()}
    )


def test_i5_an_accepted_late_reply_is_found(campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without quarantine and sync probe a late reply is accepted for the next request of its form."""
    monkeypatch.setattr("drivebus.bus.scheduler.Scheduler.mark_suspect", lambda scheduler, station, now: None)
    monkeypatch.setattr("drivebus.bus.station.Station.mark_suspect", lambda station, now: None)
    monkeypatch.setattr("drivebus.bus.core.BusCore._reject_reason", lambda core, transaction: None)
    scenario = make_scenario(campaign_run, VC660, (1,), line_quality="late=0.2:0.3")
    scenario.monitor(1)
    scenario.run(300.0)
    assert found(campaign_run, "I5")


@pytest.mark.parametrize("variant", [C320, C320_HEX, VC660], ids=lambda variant: variant.name)
def test_i6_a_gap_that_is_too_short_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch, variant: DriveVariant
) -> None:
    scenario = make_scenario(campaign_run, variant, range(1, 9))
    for address, station in scenario.bus.core.stations.items():
        station.gap_s *= 0.9
        scenario.monitor(address)
    scenario.run(5.0)
    assert found(campaign_run, "I6")


def test_i6_a_second_request_while_one_is_out_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Transaction.__init__

    def hasty(transaction: Transaction, *arguments: Any, **named: Any) -> None:
        plain(transaction, *arguments, **named)
        transaction.deadline = transaction.ends_at = transaction.tx_end_at + 0.001

    monkeypatch.setattr(Transaction, "__init__", hasty)
    scenario = make_scenario(campaign_run, DZB100, range(1, 9))
    for address in scenario.drives:
        scenario.monitor(address)
    scenario.run(5.0)
    assert found(campaign_run, "I6")


@pytest.mark.parametrize("variant", DRIVE_VARIANTS, ids=lambda variant: variant.name)
def test_i7_a_frequency_beyond_the_limit_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch, variant: DriveVariant
) -> None:
    monkeypatch.setattr("drivebus.drives.context.DriveContext._check_limits", lambda memory, hz: None)
    scenario = make_scenario(campaign_run, variant)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    scenario.finish(scenario.command(1, "run", variant.maximum_hz + 0.1))
    assert found(campaign_run, "I7")


@pytest.mark.parametrize(
    "variant",
    [variant for variant in DRIVE_VARIANTS if campaign_of(variant.model).saved_parameters],
    ids=lambda variant: variant.name,
)
def test_i7_one_save_more_than_a_day_has_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch, variant: DriveVariant
) -> None:
    """The budget counts days of the wall clock."""
    monkeypatch.setattr(EepromBudget, "consume", lambda wear, notation, day: iter(()))
    clock = JumpingWallClock(before_midnight(3600.0), lambda: 0.0)
    notation = campaign_of(variant.model).saved_parameters[variant.model]
    with installed_clock(clock):
        scenario = make_scenario(campaign_run, variant)
        for number in range(20):
            scenario.finish(scenario.command(1, "write", {notation: 10.0 + number}, save=True))
        assert campaign_run.violations == []
        scenario.finish(scenario.command(1, "write", {notation: 40.0}, save=True))
        assert found(campaign_run, "I7")
        campaign_run.violations.clear()
        clock.jump("+1 h")
        scenario.finish(scenario.command(1, "write", {notation: 10.0}, save=True))
        assert campaign_run.violations == []


@pytest.mark.parametrize(
    ("variant", "frame"),
    [
        (VC660, "01 06 20 0B 00 01"),
        (VC660, "01 06 81 C3 00 01"),
        (VC660, "01 06 20 00 00 81"),
        (DF800, "01 06 20 00 00 0E"),
        (DF800, "01 06 20 00 00 21"),
        (DF800, "01 06 20 02 00 01"),
        (DF800, "01 06 00 05 00 01"),
        (DZB100, "50 03 01 30 31 38 31 30 30 30 30"),
    ],
    ids=lambda arguments: getattr(arguments, "name", arguments),
)
def test_i7_an_unlisted_address_or_word_is_rejected(variant: DriveVariant, frame: str) -> None:
    """200BH, an address after the last one, undefined codes, the toggle and a monitor are rejected (T12, T16)."""
    data = bytes.fromhex(frame)
    with pytest.raises(ValueError, match=r"is on no list|no command is"):
        decode_write(variant, data if variant is DZB100 else ModbusReference("rtu").reseal(data + b"\0\0"))


@pytest.mark.parametrize(
    ("variant", "frame", "content"),
    [
        (C320, b"*0041103E701D5\r", ReferenceWrite(hz=9.99)),
        (C320, b"*00500117036602A0\r", ReferenceWrite(parameter=0x117, saved=True)),
        (C320, b"*00300117036602A0\r", ReferenceWrite(parameter=0x117)),
        (VC660, "01 06 20 01 03 E7 00 00", ReferenceWrite(hz=9.99)),
        (VC660, "01 06 00 17 00 01 00 00", ReferenceWrite(parameter=0x17)),
        (VC660, "01 06 80 17 00 01 00 00", ReferenceWrite(parameter=0x17, saved=True)),
        (DF800, "01 06 00 6B 00 01 00 00", ReferenceWrite(parameter=107, saved=True)),
        (DZB100, b"C\x03\x01010103E8", ReferenceWrite(hz=100.0)),
        (DZB100, b"P\x03\x0101800001", ReferenceWrite(parameter=80, saved=True)),
    ],
)
def test_a_write_has_the_content_of_the_manual(
    variant: DriveVariant, frame: bytes | str, content: ReferenceWrite
) -> None:
    data = bytes.fromhex(frame) if isinstance(frame, str) else frame
    assert decode_write(variant, _sealed(variant.model, variant.encoding, data)) == content


def test_i7_a_write_of_the_c320_that_carries_an_operation_is_rejected() -> None:
    """Class 3 with a run command would start the motor (T01)."""
    with pytest.raises(ValueError, match="carries operation 01"):
        decode_write(C320, _sealed("c320", "ascii", b"*003010000001....\r"))


def _sealed(family: str, encoding: str, frame: bytes) -> bytes:
    """Return the frame with the check of its protocol; the DZB100 has none."""
    if family == "dzb100":
        return frame
    return (SunfarReference(encoding) if family == "c320" else ModbusReference(encoding)).reseal(frame)


def test_i8_an_error_that_escapes_is_found(campaign_run: CampaignRun) -> None:
    scenario = make_scenario(campaign_run)

    def fails(status: Any) -> None:
        raise ZeroDivisionError("a sink that fails")

    with running(scenario.loop):
        scenario.drives[1].monitor(on_change=fails)
    scenario.run(1.0)
    assert found(campaign_run, "I8")


def test_i10_a_start_from_before_the_port_was_lost_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivebus.bus.prepared_request.PreparedRequest.permit_error", lambda job, now: None)
    monkeypatch.setattr(BusCore, "on_port_lost", _forgets_nothing)
    monkeypatch.setattr("drivebus.bus.scheduler.Scheduler._reject_if_stale", lambda scheduler, lane, job, now: False)
    scenario = make_scenario(campaign_run, C320)
    for instant in range(40):
        run = scenario.command(1, "run", 12.0)
        scenario.run(0.02 * instant)
        scenario.unplug()
        scenario.replug()
        scenario.finish(run)
        scenario.station(1).keypad_stop()
        scenario.run(20.0)
    assert found(campaign_run, "I10")


def _forgets_nothing(core: BusCore, error: Exception, now: float) -> list[Any]:
    """Lose the port but keep the queue."""
    core.is_open = False
    transaction, core.transaction = core.transaction, None
    if transaction is not None:
        core.scheduler.enqueue(transaction.prepared)
    commands, core._commands = core._commands, []
    return commands


def test_i11_a_read_that_acts_is_found(campaign_run: CampaignRun) -> None:
    scenario = make_scenario(campaign_run)
    station = scenario.station(1)
    answer = station.handle_request

    def acts(replacement: Any, codec: Any) -> Any:
        station.setpoint_hz += 1.0
        return answer(replacement, codec)

    station.handle_request = acts
    scenario.monitor(1)
    scenario.run(1.0)
    assert found(campaign_run, "I11")


def test_i12_an_unlimited_memory_of_requests_is_found(
    campaign_run: CampaignRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    remembered: list[Any] = []
    monkeypatch.setattr(
        Station,
        "remember_unanswered",
        lambda station, request, _, now, **more: remembered.append(UnansweredRequest(now, request, now, **more)),
    )
    scenario = make_scenario(campaign_run, line_quality="loss=0.1")
    scenario.bus.core.stations[1].unanswered_requests = remembered
    scenario.monitor(1)
    scenario.run(1500.0)
    scenario.close()
    assert found(campaign_run, "I12")


def test_i12_a_queue_that_only_grows_is_found(campaign_run: CampaignRun) -> None:
    scenario = make_scenario(campaign_run)
    with running(scenario.loop):
        for _ in range(500):
            scenario.loop.create_task(scenario.drives[1].read(("F00.00",)))
    scenario.run(0.1)
    assert found(campaign_run, "I12")


def test_requests_have_the_effect_of_the_manuals() -> None:
    """The reference decoders classify frames of the manuals (T01, T07, T16)."""
    effects = {
        ("c320", "ascii", "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D"): (0, RequestEffect.READ),
        ("c320", "ascii", "2A 30 30 34 31 31 30 33 45 37 30 31 44 35 0D"): (0, RequestEffect.MOTION),
        ("c320", "ascii", "2A 30 30 32 30 31 30 30 31 30 31 38 34 0D"): (0, RequestEffect.MOTION),
        ("c320", "ascii", "2A 31 46 34 32 31 30 30 30 30 30 31 43 45 0D"): (31, RequestEffect.STOP),
        ("c320", "hex", "5A 00 00 03 00 00 00 00 02 00 00 17 72 00 00 00 8E 0D"): (0, RequestEffect.SETTING),
        ("vc660", "rtu", "01 06 20 00 00 01 43 CA"): (1, RequestEffect.MOTION),
        ("vc660", "rtu", "01 06 20 00 00 02 03 CB"): (1, RequestEffect.STOP),
        ("vc660", "rtu", "01 06 20 00 00 04 00 00"): (1, RequestEffect.RELEASE),
        ("vc660", "rtu", "01 06 20 00 00 84 00 00"): (1, RequestEffect.SETTING),
        ("vc660", "rtu", "01 06 20 00 01 04 00 00"): (1, RequestEffect.MOTION),
        ("df800", "rtu", "01 06 20 00 00 01 43 CA"): (1, RequestEffect.STOP),
        ("df800", "rtu", "01 06 20 00 00 0A 00 00"): (1, RequestEffect.MOTION),
        ("dzb100", "ascii", "43 03 01 30 31 30 31 30 30 36 34"): (1, RequestEffect.MOTION),
        ("dzb100", "ascii", "43 03 01 30 31 30 30 30 30 30 30"): (1, RequestEffect.STOP),
    }
    for (family, encoding, frame), meaning in effects.items():
        data = _sealed(family, encoding, bytes.fromhex(frame))
        assert classify_request(family, encoding, data) == meaning, frame


@pytest.mark.parametrize(
    ("family", "encoding", "frame"),
    [
        ("c320", "ascii", b"*001000000182\r"),
        ("dzb100", "ascii", b"C\x03\x010101006"),
        ("vc660", "rtu", bytes.fromhex("01 06 20 00 00 01 43 CB")),
        ("df800", "ascii", b":010620000001D9\r\n"),
    ],
)
def test_a_request_with_a_wrong_check_or_length_is_no_request_of_the_manual(
    family: str, encoding: str, frame: bytes
) -> None:
    with pytest.raises(ValueError, match=r"^no request of"):
        classify_request(family, encoding, frame)


@pytest.mark.parametrize(
    "frame", ["2A 30 30 37 30 30 30 30 30 30 31 38 31 0D", "2A 30 30 31 32 32 30 30 30 30 31 38 31 0D"]
)
def test_undefined_requests_are_rejected(frame: str) -> None:
    with pytest.raises(ValueError):
        classify_request("c320", "ascii", _sealed("c320", "ascii", bytes.fromhex(frame)))


def test_i8_an_error_that_escapes_from_a_command_is_found(campaign_run: CampaignRun) -> None:
    async def fails() -> None:
        raise RuntimeError("not ours")

    scenario = make_scenario(campaign_run)
    scenario.finish(scenario.command_by(fails, 1, "run"))
    assert found(campaign_run, "I8")


@pytest.mark.parametrize("is_ended", [False, True])
def test_only_the_end_of_a_jog_may_go_before_a_commanded_stop_and_the_stop_stays_due(*, is_ended: bool) -> None:
    """A jog ended, its drive had answered the stop of another user, and a second stop was commanded in that instant."""
    violations: list[str] = []
    rules = FrameRules(VC660, 0.001, violations.append)
    jog, stop = (
        UserCommand(number=number, address=1, method=method, arguments=(), at=at, day=date(2026, 1, 1))
        for number, method, at in ((1, "jog", 0.0), (2, "stop", 3.05))
    )

    def send(at: float, effect: RequestEffect, command: UserCommand | None = None) -> None:
        rules.on_request(ClassifiedFrame(at, at + 0.01, 1, effect, command), at - 0.5, answered=True)

    send(1.0, RequestEffect.MOTION, jog)
    send(2.0, RequestEffect.STOP)
    send(3.0, RequestEffect.READ)
    jog.ended_at = 3.0 if is_ended else None
    rules.on_stop_command(stop, port_open=True)
    send(4.0, RequestEffect.RELEASE)
    assert [" rest to 1 was sent before a stop" in text for text in violations] == [True] * is_ended
    send(5.0, RequestEffect.READ)
    assert " read to 1 was sent before a stop" in violations[-1]


def test_a_lease_can_be_renewed_in_virtual_time(campaign_run: CampaignRun) -> None:
    async def jog() -> Any:
        async with scenario.drives[1].jog() as lease:
            for _ in range(3):
                await asyncio.sleep(0.3)
                lease.renew()
        return lease.start_outcome

    scenario = make_scenario(campaign_run)
    command = scenario.command_by(jog, 1, "jog")
    scenario.finish(command)
    assert command.result_word == "acknowledged" and campaign_run.violations == []
