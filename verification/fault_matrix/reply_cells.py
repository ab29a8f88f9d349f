"""Rows of the table: missing replies, late replies, error replies and drive faults."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

from drivebus import i18n
from drivebus.bus import TraceKind
from drivebus.simulator.motor import Trip
from verification.drive_variants import DriveVariant
from verification.families.campaigns import campaign_of
from verification.families.sunfar.facts import class_and_operation
from verification.fault_matrix.cell import CellRun, cell, check_failed_read, check_persistent_failure, check_quarantine
from verification.fault_matrix.matrix_scenario import MatrixScenario, WireSend
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import classify_request, is_sync_probe, shows_standstill, status_read_key
from verification.scenario.scenario import SentRequest

# --- no reply ---------------------------------------------------------------------------------------------------------

READING_MAX_AGE_S = 2.0
"""Longest age of a start's frame, in seconds."""
SETPOINT_MAX_AGE_S = 5.0
IMMEDIATE_MAX_S = 0.3
RECOVERY_MAX_S = 4.0
"""Longest pause between two repeated stops of an absent drive, in seconds."""


@cell("no_answer_read")
def no_reply_to_read(run: CellRun) -> None:
    """Check a read without a reply, whether the drive received it or not."""
    scenario = run.scenario()
    check_failed_read(scenario, "mute", "NoReply")
    check_failed_read(scenario, "deaf", "NoReply")
    check_persistent_failure(scenario, "deaf")
    scenario.expect(str(scenario.bus.health(1).presence) == "offline", "a drive that never answers is called present")


@cell("no_answer_setpoint")
def no_reply_to_setpoint(run: CellRun) -> None:
    """Check a setpoint without a reply: it is sent again after a sync probe, except on the DZB100, whose frame is a run
    command."""
    whole = _setpoint_is_a_run_command(run.variant)
    frame = RequestEffect.MOTION if whole else RequestEffect.SETTING
    for lost, ends in (("mute", "done"), ("deaf", "done"), ("always", "open")):
        scenario, first, second = run.scenario(1), run.random_hz(5, 12), run.random_hz(12, 20)
        scenario.start_at(1, first)
        mark = len(scenario.requests)
        manipulation = scenario.manipulate_replies(
            1, "deaf" if lost == "always" else lost, 9 if lost == "always" else 1, frame
        )
        command = scenario.command_to_end(1, "set_frequency", second)
        scenario.expect(manipulation.remaining < 9, "no frame was lost")
        _check_setpoint(scenario, lost, ends, command.result_word, scenario.requests_since(mark, frame), mark)
        scenario.run(3.0)
        taken = abs(scenario.station(1).motor.target_hz - second) < 0.006
        scenario.expect(taken is command.succeeded, f"{command.result_word}, taken: {taken}")


def _setpoint_is_a_run_command(variant: DriveVariant) -> bool:
    """Return whether a setpoint is sent as a run command (DZB100); the C320 has an operation for it."""
    return variant.start_has_setpoint and variant.setpoint_readable


def _check_setpoint(
    scenario: MatrixScenario, lost: str, ends: str, word: str, frames: list[SentRequest], mark: int
) -> None:
    shows = scenario.variant.setpoint_readable
    if _setpoint_is_a_run_command(
        scenario.variant
    ):  # the frame starts the drive: never sent again where it was running
        scenario.expect(len(frames) == 1, f"the run command was sent {len(frames)} times")
        scenario.expect(word == ("confirmed" if lost == "mute" else "failed"), f"{lost}: {word}")
        return
    good = "confirmed" if shows else "acknowledged"
    scenario.expect(word == (good if ends == "done" else "failed" if shows else "unknown"), f"{lost}: {word}")
    scenario.expect(2 <= len(frames) <= 3 and len({frame.data for frame in frames}) == 1, f"{len(frames)} setpoints")
    scenario.expect(frames[-1].start - frames[0].start < SETPOINT_MAX_AGE_S, "resent when it was too old")
    for one, other in pairwise(frames):
        between = [sent for sent in scenario.requests_since(mark) if one.end < sent.start < other.start]
        scenario.expect(scenario.sync_probes(between), "sent again without a sync probe")


@cell("no_answer_start")
def no_reply_to_start(run: CellRun) -> None:
    """Check that a start is executed once: sent again only after two status reads of standstill, within 2 s, and never
    on the DF800."""
    for lost in ("mute", "deaf", "always"):
        scenario = run.scenario(1)
        mark = len(scenario.requests)
        scenario.manipulate_replies(
            1, "mute" if lost == "mute" else "deaf", 9 if lost == "always" else 1, RequestEffect.MOTION
        )
        command = scenario.command_to_end(1, "run", run.random_hz())
        scenario.run(1.0)
        starts, motor = scenario.requests_since(mark, RequestEffect.MOTION), scenario.station(1).motor
        scenario.expect(
            motor.starts == (lost == "mute" or (lost == "deaf" and run.variant.reports_running)),
            f"{motor.starts} starts",
        )
        if not run.variant.reports_running:
            scenario.expect(
                len(starts) == 1 and command.result_word == "unknown",
                f"{len(starts)} starts, ended as {command.result_word}",
            )
            continue
        expected = {"mute": ("confirmed",), "deaf": ("confirmed",), "always": ("failed", "unknown")}[lost]
        scenario.expect(command.result_word in expected, f"{lost}: {command.result_word}")
        scenario.expect(len(starts) == {"mute": 1, "deaf": 2}.get(lost, len(starts)), f"{lost}: {len(starts)} starts")
        _check_start_resent(scenario, starts)


def _check_start_resent(scenario: MatrixScenario, starts: list[SentRequest]) -> None:
    scenario.expect(len(starts) <= 3, f"sent {len(starts)} times")
    for one, other in pairwise(starts):
        between = [sent for sent in scenario.requests if one.end < sent.start < other.start]
        replies = [reply for reply in scenario.replies if one.end < reply.start < other.start]
        shown = [
            shows_standstill(scenario.variant, reply.request, reply.data)
            for reply in replies
            if status_read_key(scenario.variant, reply.request)
        ]
        scenario.expect(len(scenario.sync_probes(between)) >= 2, "sent again without two sync probes")
        scenario.expect(len(shown) >= 2 and all(shown), "resent without two reads of standstill")
        scenario.expect(other.start - starts[0].start < READING_MAX_AGE_S, "resent when it was too old")


@cell("no_answer_stop")
def no_reply_to_stop(run: CellRun) -> None:
    """Check that a stop is repeated and reported as unconfirmed until the drive shows standstill."""
    scenario = run.scenario(1)
    scenario.start_at(1, run.random_hz())
    scenario.station(1).faults.silent = True
    mark, command = len(scenario.requests), scenario.command_to_end(1, "stop")
    scenario.expect(
        type(command.error).__name__ == "StopUnconfirmed" and scenario.drives[1].stop_pending,
        f"ended as {command.error!r}",
    )
    scenario.run(run.rng.uniform(15.0, 25.0))
    stops = scenario.requests_since(mark, RequestEffect.STOP)
    scenario.expect(
        stops[1].start - stops[0].end < IMMEDIATE_MAX_S, f"again after {stops[1].start - stops[0].end:.3f} s"
    )
    pauses = [other.start - one.end for one, other in pairwise(stops)]
    scenario.expect(
        max(pauses) < RECOVERY_MAX_S and scenario.loop.time() - stops[-1].end < RECOVERY_MAX_S,
        f"paused {max(pauses):.1f} s",
    )
    _check_recovery(scenario)
    _check_unanswered_stop(run)


def _check_recovery(scenario: MatrixScenario) -> None:
    """Check that a drive that receives again stops, and that the stop is confirmed only at standstill."""
    scenario.station(1).faults.silent = False
    end = scenario.loop.time() + 20.0
    while scenario.drives[1].stop_pending and scenario.loop.time() < end:
        scenario.run(0.05)
    scenario.expect(not scenario.drives[1].stop_pending, "repeated although the drive replies again")
    scenario.expect(
        not scenario.variant.reports_running or not scenario.station(1).motor.energised,
        "no longer repeated, and it runs",
    )
    if scenario.variant.reports_running:
        standstill_confirmed_twice(scenario)
    scenario.run(3.0)
    mark = len(scenario.requests)
    scenario.run(5.0)
    scenario.expect(
        not scenario.requests_since(mark, RequestEffect.STOP) and not scenario.station(1).motor.energised,
        "does not come to rest",
    )


def standstill_confirmed_twice(scenario: MatrixScenario) -> None:
    """Check that the last two replies to each kind of status read showed standstill."""
    answers: dict[bytes, list[bool]] = {}
    for reply in scenario.replies:
        shown, question = (
            shows_standstill(scenario.variant, reply.request, reply.data),
            status_read_key(scenario.variant, reply.request),
        )
        if question is not None and shown is not None:
            answers.setdefault(question, []).append(shown)
    wanted = scenario.variant.status_read_count
    scenario.expect(len(answers) == wanted, f"{len(answers)} kinds of questions")
    scenario.expect(
        all(len(answer) >= 2 and all(answer[-2:]) for answer in answers.values()), f"taken for standstill: {answers}"
    )


def _check_unanswered_stop(run: CellRun) -> None:
    """Check that a stop without a reply is unknown although the drive stopped."""
    scenario = run.scenario(1)
    scenario.start_at(1, run.random_hz())
    scenario.station(1).faults.mute = True
    command = scenario.command_to_end(1, "stop")
    scenario.run(3.0)
    scenario.expect(
        command.result_word == "unknown" and scenario.drives[1].stop_pending, f"ended as {command.result_word}"
    )
    scenario.expect(not scenario.station(1).motor.energised, "it got the stop and runs")


# --- late replies and other addresses ---------------------------------------------------------------------------------

UNUSED_ADDRESS = 9
PROBE_INTERVAL_S = 8.0
"""Time until the next sync probe of a DF800 counts, in seconds: its sync probes are identical."""


@cell("late_same_item")
def late_reply_to_the_same_request(run: CellRun) -> None:
    """Check that a late reply is counted and never accepted, not even for the same request."""
    scenario = run.scenario()
    late_s = run.rng.uniform(*run.variant.lateness_range_s)
    late = scenario.unsolicited_count("late")
    check_failed_read(scenario, lambda transmit, data, when: transmit(data, when + late_s), "NoReply")
    scenario.expect(scenario.unsolicited_count("late") == late + 1, "a late reply was not counted")
    scenario.expect(
        sum(event.kind is TraceKind.LATE for event in scenario.events) == 1, "a late reply was not reported"
    )


@cell("late_other_item")
def late_reply_during_another_request(run: CellRun) -> None:
    """Check that a late reply during a sync probe is not accepted, and that nothing is accepted until a sync probe is
    answered."""
    scenario, held = run.scenario(), list[bytes]()
    wanted, _ = scenario.plain_read(1)

    def hold(transmit: WireSend, data: bytes, when: float) -> Any:
        held.append(data)

    def release(transmit: WireSend, data: bytes, when: float) -> Any:
        late = transmit(held[0], when)
        return transmit(data, late.end + scenario.simulated_bus.settings.seconds(5))

    mark = len(scenario.requests)
    scenario.manipulate_replies(1, hold, 1)
    scenario.manipulate_replies(1, release, 1)
    answer = scenario.transact(1, wanted)
    check_quarantine(scenario, mark)
    scenario.expect(answer.error is not None, f"accepted: {answer.received.hex()}")
    scenario.expect(scenario.bus.health(1).suspect, "accepted again without a sync probe")
    scenario.run(PROBE_INTERVAL_S)
    scenario.expect(not scenario.bus.health(1).suspect, "never probed again")
    fresh = scenario.transact(1, wanted)
    scenario.expect(fresh.error is None and fresh.received == scenario.replies[-1].data, f"{fresh}")
    if run.variant.model == "c320":
        _check_same_key_other_class(scenario)


def _check_same_key_other_class(scenario: MatrixScenario) -> None:
    """Check that a sync probe separates monitor d.1 and parameter F0.1, whose replies look alike (T04)."""
    scenario.loop.run_until_complete(scenario.drives[1].status(("output_voltage",)))
    mark = len(scenario.requests)
    scenario.loop.run_until_complete(scenario.drives[1].read(("F0.1",)))
    sent = scenario.requests_since(mark)
    parameter = next(
        request
        for request in sent
        if class_and_operation(scenario.variant, request.data)[0] == 2
        and not is_sync_probe(scenario.variant, request.data)
    )
    scenario.expect(
        scenario.sync_probes(request for request in sent if request.start < parameter.start), "F0.1 right after d.1"
    )


@cell("other_address")
def reply_from_another_address(run: CellRun) -> None:
    """Check that a reply of another address is dropped and counted, and that the true reply after it is accepted."""
    scenario = run.scenario()
    wanted, _ = scenario.plain_read(1)
    theirs = next(reply.data for reply in scenario.replies if reply.address == 2)
    foreign = scenario.unsolicited_count("foreign")

    def first_theirs(transmit: WireSend, data: bytes, when: float) -> Any:
        character_s = scenario.simulated_bus.settings.character_s
        foreign = transmit(theirs, scenario.loop.time() + character_s, scenario.station(2))
        return transmit(data, foreign.end + character_s)

    scenario.manipulate_replies(1, first_theirs, 1)
    answer = scenario.transact(1, wanted)
    scenario.expect(answer.error is None and answer.attempts == 1, f"the true answer was lost: {answer.error}")
    scenario.expect(
        answer.received == scenario.replies[-1].data and scenario.unsolicited_count("foreign") == foreign + 1,
        "not counted",
    )
    scenario.run(3.0)
    _check_misaddressed(scenario, wanted)


def _check_misaddressed(scenario: MatrixScenario, wanted: Any) -> None:
    """Check that replies of an unknown address are never accepted and raise the foreign master alarm."""
    scenario.station(1).faults.wrong_address = UNUSED_ADDRESS
    for _ in range(2):
        before = scenario.loop.time()
        answer = scenario.transact(1, wanted)
        scenario.expect(answer.error is not None, "a reply of another address was accepted")
        scenario.expect(scenario.loop.time() - before < 2.0, "the deadline moved")
        scenario.run(1.5)
    scenario.expect(scenario.bus.health(1).foreign_master, "no alarm")
    scenario.station(1).faults.wrong_address = None
    scenario.run(1.5)
    command = scenario.command_to_end(2, "run", 5.0)
    scenario.expect(
        command.result_word == "StartInhibited" and not scenario.station(2).motor.starts,
        f"a start is {command.result_word}",
    )


# --- error replies and drive faults -----------------------------------------------------------------------------------


@cell("error_answer")
def error_answers(run: CellRun) -> None:
    """Check that each error code refuses the write once, with a text in both languages."""
    scenario = run.scenario(1)
    replies = campaign_of(run.variant.model).matrix.error_replies(run.variant)
    for code, reply in run.rng.sample(replies, len(replies)):
        _check_rejected(scenario, code, reply)


def _check_rejected(scenario: MatrixScenario, code: int | None, error_reply: Callable[[Any], Any]) -> None:
    station, family = scenario.station(1), campaign_of(scenario.variant.model)
    notation = family.saved_parameters.get(scenario.variant.model)
    answer = station.handle_request

    def refusing(message: Any, codec: Any) -> Any:
        request = getattr(message, "request", message)
        frame = scenario.drives[1].dialect.codec.encode_request(request)
        effect = classify_request(scenario.variant.model, scenario.variant.encoding, frame)[1]
        return error_reply(request) if effect is RequestEffect.SETTING else answer(message, codec)

    station.handle_request = refusing
    mark, failed = len(scenario.requests), scenario.failure_count(1)
    if notation is None:
        command = scenario.command_to_end(1, "set_frequency", 12.0)
    else:
        is_saved = notation not in family.matrix.ram_parameters
        command = scenario.command_to_end(1, "write", {notation: 12.0}, save=is_saved)
    station.handle_request = answer
    scenario.expect(command.result_word == "refused", f"code {code}: {command.result_word}")
    scenario.expect(
        len(scenario.requests_since(mark, RequestEffect.SETTING)) == 1,
        f"code {code}: sent {len(scenario.requests_since(mark, RequestEffect.SETTING))} times",
    )
    scenario.expect(scenario.failure_count(1) == failed, "counted as a failure of the line")
    outcome = command.outcome
    scenario.expect(outcome.params.get("code") == code, f"reported code {outcome.params}")
    words = {i18n.text(outcome.key, language, **outcome.params) for language in ("en", "zh")}
    scenario.expect(len(words) == 2 and outcome.key not in words, f"{outcome.key} has no words in both languages")


DZB100_FAULT_LABELS = {
    2: "E00A",
    3: "E00E",
    4: "E008",
    6: "E00D",
    7: "E012",
    10: "E004",
    11: "E006",
    12: "E005",
    14: "E001",
}
"""CD of Q03 and the label on the keypad, by the table of the manual."""


@cell("status_fault")
def drive_in_fault(run: CellRun) -> None:
    """Check that the fault and its code are reported and block a start; the DF800 reports none."""
    scenario = run.scenario(1)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    station, trip = scenario.station(1), run.rng.choice(list(Trip))
    scenario.start_at(1, run.random_hz())
    station.trip(trip)
    status = scenario.loop.run_until_complete(scenario.drives[1].status())
    if not run.variant.reports_running:
        scenario.expect(str(status.state) == "unknown" and status.fault is None, f"{status}")
        scenario.expect(status.reason == "drives.no_run_status", f"the reason is {status.reason}")
        return
    if not run.variant.reports_faults:
        scenario.expect(str(status.state) == "stopped" and status.fault is None, f"{status}")
        return
    scenario.expect(str(status.state) == "fault", f"{status}")
    _check_fault_named(scenario, status.fault, station.trip_code(trip))
    mark, command = len(scenario.requests), scenario.command_to_end(1, "run", run.random_hz())
    scenario.expect(
        command.result_word == "StartInhibited" and not scenario.requests_since(mark, RequestEffect.MOTION),
        f"a start in fault is {command.result_word}",
    )
    if run.variant.model == "c320":
        _check_item_missing(scenario)


def _check_fault_named(scenario: MatrixScenario, fault: Any, code: int) -> None:
    named = not scenario.variant.numbers_faults or (fault is not None and fault.code == code)
    scenario.expect(fault is not None and named, f"{fault} instead of {code}")
    words = {getattr(fault.text, language) for language in ("en", "zh")}
    scenario.expect(len(words) == 2 and "" not in words, f"fault {code} has no words in both languages")
    if scenario.variant.model == "dzb100":
        scenario.expect(fault.label == DZB100_FAULT_LABELS.get(code, fault.label), f"{code} is called {fault.label}")


def _check_item_missing(scenario: MatrixScenario) -> None:
    """Check that values are not good while the fault code replaces the item (T05)."""
    readings = scenario.loop.run_until_complete(
        scenario.drives[1].status(("output_frequency", "dc_bus_voltage"))
    ).readings
    for name in ("output_frequency", "dc_bus_voltage"):
        scenario.expect(str(readings[name].quality) != "good", f"{name} is {readings[name]}")
        scenario.expect(readings[name].reason == "drives.item_not_echoed", f"{name}: {readings[name].reason}")
