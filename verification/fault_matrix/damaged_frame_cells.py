"""Rows of the table: truncated replies, extra bytes, garbage, flipped bits, swapped digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.bus import TraceKind
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality
from verification.families.campaigns import campaign_of
from verification.fault_matrix.cell import COVERED, CellRun, cell, check_failed_read, check_persistent_failure
from verification.fault_matrix.matrix_scenario import MatrixScenario, ReplyAction, WireSend

# --- swapped digits ---------------------------------------------------------------------------------------------------

DIGITS_OBSERVATION_S = 6.0
"""Longer than any reply can be late, in seconds: garbage differs from a late reply only where none can arrive."""


def swap_neighbours(data: bytes, index: int) -> bytes:
    return data[:index] + data[index + 1 : index + 2] + data[index : index + 1] + data[index + 2 :]


def swapped_digits(run: CellRun, first: int, last: int) -> Any:
    """Return an action that swaps two different neighbours within these bytes."""

    def act(transmit: WireSend, data: bytes, when: float) -> Any:
        places = [index for index in range(first, min(last, len(data)) - 1) if data[index] != data[index + 1]]
        return transmit(swap_neighbours(data, run.rng.choice(places)), when)

    return act


@cell("digit_swap", *(variant for variant in COVERED if variant.undetected_swaps is None))
def swapped_digits_meet_a_check(run: CellRun) -> None:
    """Check that CRC and LRC detect every swap of neighbours."""
    scenario = run.scenario()
    scenario.station(1).keypad_run(run.random_hz())
    for _ in range(4):
        scenario.run(DIGITS_OBSERVATION_S)
        size = len(scenario.replies[0].data)
        first, last = (1, size - 2) if run.variant.encoding == "ascii" else (0, size)
        failed = scenario.failure_count(1)
        scenario.manipulate_replies(1, swapped_digits(run, first, last), 1)
        answer = scenario.read(1)
        scenario.expect(answer.error is None and answer.attempts == 2, f"a swap was accepted: {answer}")
        scenario.expect(scenario.failure_count(1) == failed + 1, f"not counted: {scenario.statistics(1).errors}")


@cell("digit_swap", *(variant for variant in COVERED if variant.undetected_swaps is not None))
def swapped_digits_pass_the_check(run: CellRun) -> None:
    """Check swaps that the sum does not detect: invalid in repeated fields, uncertain in values out of range."""
    scenario = run.scenario(12, 13)
    assert run.variant.undetected_swaps is not None
    first, last = run.variant.undetected_swaps
    for _ in range(3):
        scenario.run(DIGITS_OBSERVATION_S)
        attempts = _check_one_swap(run, scenario, first, last)
        scenario.expect(attempts == 2, "a reply with another address or item was accepted")
    single_reads_decide_nothing(run)
    if run.variant.model == "c320":
        _check_out_of_range_value(run)


def _check_one_swap(run: CellRun, scenario: MatrixScenario, first: int, last: int) -> int:
    scenario.manipulate_replies(12, swapped_digits(run, first, last), 1)
    answer = scenario.read(12)
    scenario.expect(answer.error is None and answer.received == scenario.replies[-1].data, f"{answer}")
    return answer.attempts


def single_reads_decide_nothing(run: CellRun) -> None:
    """Check that one wrong reply neither makes a stopped drive running nor a running drive stopped."""
    scenario = run.scenario(1)
    monitor = scenario.monitored(1)
    states = []
    for _ in range(4):
        scenario.manipulate_replies(1, falsified_replies(run, stopped=False), 1)
        for _ in range(12):
            scenario.run(0.1)
            states.append(str(monitor.status().state))
    scenario.expect(
        {"stopped"} <= set(states) <= {"stopped", "unknown"}, f"a standing drive is called {sorted(set(states))}"
    )
    monitor.close()
    scenario.monitors.clear()
    scenario.start_at(1, run.random_hz(15, 20))
    scenario.station(1).faults.frozen_readings = False
    for _ in range(3):
        scenario.manipulate_replies(1, falsified_replies(run, stopped=True), 1)
        status = scenario.loop.run_until_complete(scenario.drives[1].status())
        scenario.expect(str(status.state) == "running", f"a running drive is called {status.state}")


def falsified_replies(run: CellRun, *, stopped: bool) -> Any:
    """Return an action that falsifies the state in a reply, with a correct check."""

    def act(transmit: WireSend, data: bytes, when: float) -> Any:
        return transmit(campaign_of(run.variant.model).matrix.falsify_state(run.variant, data, stopped=stopped), when)

    return act


def _check_out_of_range_value(run: CellRun) -> None:
    """Check that d.4 above its plausible limit of 1,200 V is shown as uncertain."""
    scenario = run.scenario(1)
    monitor = scenario.monitor(1, ("dc_bus_voltage",))
    scenario.run(1.0)
    reading = monitor.status().readings["dc_bus_voltage"]
    scenario.expect(reading.quality is Quality.GOOD, f"{reading}")
    place = 9 if run.variant.encoding == "ascii" else 11
    manipulation = scenario.manipulate_replies(
        1, lambda transmit, data, when: transmit(swap_neighbours(data, place), when), 1
    )
    while manipulation.remaining:
        scenario.run(0.1)
    scenario.run(0.2)
    reading = monitor.status().readings["dc_bus_voltage"]
    scenario.expect(reading.quality is Quality.UNCERTAIN and (reading.raw or 0) > 1200, f"{reading}")


# --- damaged frames ---------------------------------------------------------------------------------------------------

FLIPS_PER_CELL = 6


@cell("truncated")
def truncated_answer(run: CellRun) -> None:
    """Check that a truncated reply is invalid at the deadline, and that a complete short error is accepted."""
    scenario = run.scenario()
    cut = run.rng.randrange(1, len(scenario.replies[0].data) - 1)
    check_failed_read(scenario, lambda transmit, data, when: transmit(data[:-cut], when), "NoReply")
    failure = next(event for event in scenario.events if event.kind is TraceKind.INVALID)
    request = next(request for request in scenario.requests[2:] if request.address == 1)
    min_timeout_s = (
        run.variant.min_timeout_s + run.variant.min_timeout_characters * scenario.simulated_bus.settings.character_s
    )
    scenario.expect(
        failure.time - request.end >= min_timeout_s, f"failed {failure.time - request.end:.4f} s after the request"
    )
    check_persistent_failure(scenario, lambda transmit, data, when: transmit(data[:-cut], when))
    _check_short_form(run)


def _check_short_form(run: CellRun) -> None:
    """Check that an error reply that is shorter than the normal one is complete."""
    short = campaign_of(run.variant.model).matrix.short_error(run.variant, run.rng)
    if short is None:
        return
    scenario, (reply, size) = run.scenario(), short
    codec = scenario.drives[1].dialect.codec
    data = codec.encode_reply(reply)
    scenario.expect(len(data) == size, f"{len(data)} bytes")
    scenario.manipulate_replies(1, lambda transmit, _, when: transmit(data, when), 1)
    failed = scenario.failure_count(1)
    answer = scenario.read(1)
    scenario.expect(answer.error is None and answer.attempts == 1 and answer.received == data, f"{answer}")
    scenario.expect(scenario.failure_count(1) == failed, "an error form is no failure of the line")


@cell("trailing")
def trailing_bytes(run: CellRun) -> None:
    """Check that extra bytes make a reply invalid, and that after three of them the link is too bad for a start."""
    scenario = run.scenario()
    extra = run.rng.randbytes(run.rng.randrange(1, 5))

    def longer(transmit: WireSend, data: bytes, when: float) -> Any:
        return transmit(data + extra, when)

    for _ in range(3):
        check_failed_read(scenario, longer, "TrailingError")
    health = scenario.bus.health(1)
    scenario.expect(health.error_rate > 0.0 and scenario.statistics(1).damaged >= 3, "health does not show it")
    command = scenario.command_to_end(1, "run", 5.0)
    scenario.expect(
        command.result_word == "StartInhibited" and getattr(command.error, "key", "") == "drives.high_error_rate",
        f"a start is {command.result_word}",
    )
    scenario.expect(not scenario.station(1).motor.starts, "started")
    check_persistent_failure(run.scenario(), longer)


@cell("garbage")
def leading_garbage(run: CellRun) -> None:
    """Check that garbage before a reply makes it invalid; the codec does not search for frames in a stream."""
    scenario = run.scenario()
    for size in range(1, 5):
        junk = run.rng.randbytes(size)
        mark = len(scenario.requests)
        wanted, data = scenario.plain_read(1)
        scenario.manipulate_replies(1, after_junk(junk), 1)
        answer = scenario.transact(1, wanted)
        scenario.expect(answer.error is None and answer.attempts == 2, f"{size} bytes of junk: {answer}")
        scenario.expect([request.data for request in scenario.requests_since(mark)].count(data) == 2, "not read twice")
    _check_tolerated_noise(run)


def after_junk(junk: bytes) -> ReplyAction:
    """Return an action that transmits these bytes before the reply."""
    return lambda transmit, data, when: transmit(junk + data, when)


def _check_tolerated_noise(run: CellRun) -> None:
    """Check the option: one junk byte before a reply is tolerated, in Modbus ASCII up to four before the first ':'."""
    scenario = run.scenario()
    drive = scenario.drives[1]
    timing: StationTiming = replace(drive.dialect.station_config.timing, tolerate_leading_noise=True)
    drive.close()
    scenario.drives[1] = type(drive)(
        scenario.bus,
        run.variant.model,
        1,
        encoding=run.variant.encoding,
        options=dict(run.variant.drive_options),
        timing=timing,
    )
    scenario.read(1)
    most = 4 if run.variant.name == "df800-ascii" else 1
    for size, attempts in ((most, 1), (most + 2, 2)):
        junk = bytes(run.rng.randrange(0x80, 0x100) for _ in range(size))
        scenario.manipulate_replies(1, after_junk(junk), 1)
        answer = scenario.read(1)
        scenario.expect(answer.error is None and answer.attempts == attempts, f"{size} bytes of junk: {answer}")


def corrupt_reply(run: CellRun, *, marked: bool) -> Any:
    """Return an action that flips one bit of the reply, with or without a parity mark."""

    def act(transmit: WireSend, data: bytes, when: float) -> Any:
        index = run.rng.choice(range(len(data)))
        transmission = transmit(data, when)
        transmission.corrupt(index, data[index] ^ 1 << run.rng.randrange(8), marked=marked)
        return transmission

    return act


@cell("bit_flip")
def single_flipped_bit(run: CellRun) -> None:
    """Check that parity, sum, CRC or LRC detect a flipped bit. The DZB100 has only parity: two equal reads are
    required."""
    scenario = run.scenario()
    for number in range(FLIPS_PER_CELL):
        marked = not run.variant.has_checksum or (run.variant.undetected_swaps is not None and number % 2 == 0)
        _check_flipped(scenario, corrupt_reply(run, marked=marked))
    if not run.variant.has_checksum:
        single_reads_decide_nothing(run)


def _check_flipped(scenario: MatrixScenario, act: Any) -> None:
    """Check that the damaged reply is invalid and the read is repeated once."""
    scenario.run(DIGITS_OBSERVATION_S)
    wanted, data = scenario.plain_read(1)
    failed, mark = scenario.failure_count(1), len(scenario.requests)
    scenario.manipulate_replies(1, act, 1)
    answer = scenario.transact(1, wanted)
    scenario.expect(answer.error is None and answer.attempts == 2, f"a flipped bit was accepted: {answer}")
    scenario.expect(scenario.failure_count(1) == failed + 1, f"not counted: {scenario.statistics(1).errors}")
    scenario.expect([request.data for request in scenario.requests_since(mark)].count(data) == 2, "not read twice")
