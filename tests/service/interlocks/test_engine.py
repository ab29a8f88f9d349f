"""Interlocks over time: delay, edges, and values that were never read."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.service.config.model import InterlockAction, InterlockConfig
from drivebus.service.interlocks.engine import FIRST_POLL_GRACE_S, InterlockEngine
from drivebus.service.live.views import DriveView, SignalView
from drivebus.values import Quality, Text, bilingual_text
from fixtures.alarms import view as drive_view


def view(drive: str, state: str = "running", **signals: tuple[Any, str, Quality]) -> DriveView:
    values = {name: SignalView(value, unit, quality, None, 0.1) for name, (value, unit, quality) in signals.items()}
    return drive_view(values, drive=drive, state=state)


def views(state: str = "running", hz: Any = 25.0, quality: Quality = Quality.GOOD) -> dict[str, DriveView]:
    return {"pump": view("pump", state, output_frequency=(hz, "Hz", quality)), "fan": view("fan")}


def interlocks(require: str = "pump.state == running", **rest: Any) -> InterlockEngine:
    return InterlockEngine([InterlockConfig(id="flow", drives=("fan",), require=require, **rest)])


def ids(interlocks: list[InterlockConfig]) -> list[str]:
    return [interlock.id for interlock in interlocks]


def blocking(engine: InterlockEngine, drive: str) -> list[str]:
    return [violation.config.id for violation in engine.violations(drive)]


def blocker_text(engine: InterlockEngine, language: str) -> str:
    """Return the first reason against a start of the fan."""
    return i18n.text("interlocks.violated", language, **engine.violations("fan")[0].message_params)


def test_an_interlock_that_holds_blocks_nothing() -> None:
    engine = interlocks()
    assert engine.evaluate(views(), 0.0) == []
    assert (blocking(engine, "fan"), engine.tripped_stops("fan"), blocking(engine, "pump")) == ([], [], [])


def test_a_violation_blocks_starts_at_once_and_trips_after_its_delay() -> None:
    engine = interlocks(delay_s=2.0)
    engine.evaluate(views(), 0.0)
    assert engine.evaluate(views("stopped"), 1.0) == []
    assert (blocking(engine, "fan"), engine.tripped_stops("fan")) == (["flow"], [])
    assert engine.evaluate(views("stopped"), 2.9) == []
    assert engine.evaluate(views("stopped"), 3.0) == [("flow", False)]
    assert ids(engine.tripped_stops("fan")) == ["flow"]
    assert engine.evaluate(views("stopped"), 4.0) == [], "an edge is reported once"
    assert ids(engine.tripped_stops("fan")) == ["flow"], "it stays tripped while it does not hold"
    assert engine.tripped_stops("pump") == []


def test_an_interlock_that_holds_again_is_reported_once_and_restarts_its_delay() -> None:
    engine = interlocks(delay_s=2.0)
    engine.evaluate(views(), 0.0)
    engine.evaluate(views("stopped"), 1.0)
    assert engine.evaluate(views(), 2.0) == [], "it had not tripped"
    engine.evaluate(views("stopped"), 2.5)
    assert engine.evaluate(views("stopped"), 4.0) == []
    assert engine.evaluate(views("stopped"), 4.5) == [("flow", False)]
    assert engine.evaluate(views(), 5.0) == [("flow", True)]
    assert engine.evaluate(views(), 6.0) == []
    assert blocking(engine, "fan") == []


def test_an_interlock_with_the_action_block_start_stops_nothing() -> None:
    engine = interlocks(action=InterlockAction.BLOCK_START)
    assert engine.evaluate(views("stopped"), 0.0) == [("flow", False)]
    assert (blocking(engine, "fan"), engine.tripped_stops("fan")) == (["flow"], [])


def test_a_value_of_bad_or_uncertain_quality_violates_an_interlock() -> None:
    engine = interlocks("pump.output_frequency > 5 Hz")
    engine.evaluate(views(), 0.0)
    for quality in (Quality.UNCERTAIN, Quality.BAD):
        assert engine.evaluate(views(quality=quality), 1.0) == [("flow", False)]
        assert ids(engine.tripped_stops("fan")) == ["flow"]
        engine.evaluate(views(), 2.0)
    assert engine.evaluate(views(hz=None), 3.0) == [("flow", False)]
    engine.evaluate(views(), 4.0)
    assert engine.evaluate({}, 5.0) == [("flow", False)], "a drive that was removed"


def test_an_unknown_state_violates_a_condition_and_its_negation() -> None:
    engine = interlocks("not pump.state == running")
    engine.evaluate(views("stopped"), 0.0)
    assert engine.evaluate(views("unknown"), 1.0) == [("flow", False)]


def test_an_interlock_blocks_starts_before_its_first_evaluation() -> None:
    engine = interlocks()
    assert blocking(engine, "fan") == ["flow"] and engine.tripped_stops("fan") == []
    assert 'interlock "flow"' in blocker_text(engine, "en") and "“flow”" in blocker_text(engine, "zh")
    assert "not read yet" in blocker_text(engine, "en")
    assert engine.violations("fan")[0].reasons == (bilingual_text("interlocks.not_looked"),)
    engine.evaluate(views(), 0.0)
    assert engine.violations("fan") == []
    engine.evaluate(views("stopped"), 1.0)
    found = bilingual_text("interlocks.found", name="pump.state", value="stopped")
    require = "pump.state == running"
    assert engine.violations("fan")[0].reasons == (bilingual_text("interlocks.reason", require=require, found=found),)


def test_a_restart_trips_no_interlock_before_its_values_were_read() -> None:
    """It blocks starts meanwhile, and trips after the grace time."""
    engine = interlocks()
    assert engine.evaluate(views("unknown"), 100.0) == []
    assert (blocking(engine, "fan"), engine.tripped_stops("fan")) == (["flow"], [])
    assert engine.evaluate(views("unknown"), 100.0 + FIRST_POLL_GRACE_S - 0.01) == []
    assert engine.evaluate(views("unknown"), 100.0 + FIRST_POLL_GRACE_S) == [("flow", False)]
    assert ids(engine.tripped_stops("fan")) == ["flow"]


def test_a_known_violation_trips_at_once_after_a_restart() -> None:
    engine = interlocks()
    assert engine.evaluate(views("stopped"), 100.0) == [("flow", False)]


def test_the_grace_time_ends_with_the_first_known_result() -> None:
    engine = interlocks()
    engine.evaluate(views("unknown"), 100.0)
    engine.evaluate(views(), 101.0)
    assert engine.evaluate(views("unknown"), 102.0) == [("flow", False)]


def test_a_violation_states_its_reasons_in_both_languages() -> None:
    engine = interlocks("pump.state == running and pump.output_frequency >= 10 Hz", title=Text("Flow", "流量"))
    engine.evaluate(views("stopped", 3.5), 0.0)
    assert blocker_text(engine, "en") == (
        'interlock "Flow" is not met: pump.state == running required, pump.state is stopped; '
        "pump.output_frequency >= 10 Hz required, pump.output_frequency is 3.5 Hz"
    )
    params = engine.violations("fan")[0].message_params
    assert (params["interlock"], params["require"]) == (
        "flow",
        "pump.state == running and pump.output_frequency >= 10 Hz",
    )
    assert all(word in blocker_text(engine, "zh") for word in ("流量", "3.5 Hz", "联锁"))
    engine.evaluate(views("running", 3.5, Quality.BAD), 1.0)
    reasons = engine.violations("fan")[0].reasons
    assert [reason.en for reason in reasons] == [
        "pump.output_frequency >= 10 Hz required, pump.output_frequency has no good value"
    ]


def test_a_reload_keeps_the_state_of_unchanged_interlocks() -> None:
    engine = interlocks(delay_s=2.0)
    engine.evaluate(views(), 0.0)
    engine.evaluate(views("stopped"), 1.0)
    flow = InterlockConfig(id="flow", drives=("fan",), require="pump.state == running", delay_s=2.0)
    engine.replace([flow, InterlockConfig(id="more", drives=("fan",), require="pump.state == stopped")])
    assert "more" in blocking(engine, "fan"), "a new interlock blocks starts until its first evaluation"
    assert engine.evaluate(views("stopped"), 3.0) == [("flow", False)]
    engine.replace([InterlockConfig(id="flow", drives=("fan",), require="pump.state == stopped", delay_s=2.0)])
    assert engine.evaluate(views("stopped"), 4.0) == [] and blocking(engine, "fan") == []


def test_an_interlock_that_reads_a_replaced_drive_blocks_starts_until_it_is_evaluated_again() -> None:
    """It held, or was tripped, by the values of the motor that had the name before."""
    engine, flow = interlocks(), InterlockConfig(id="flow", drives=("fan",), require="pump.state == running")
    engine.evaluate(views(), 0.0)
    engine.replace([flow], ["fan"])
    assert blocking(engine, "fan") == [], "it stops that drive, and does not read it"
    engine.replace([flow], ["pump"])
    assert blocking(engine, "fan") == ["flow"]
    assert engine.evaluate(views("stopped"), 1.0) == [("flow", False)]
    engine.replace([flow], ["pump"])
    assert engine.evaluate(views(), 2.0) == [("flow", True)], "its alarm is cleared"
    assert blocking(engine, "fan") == []


def test_a_new_interlock_of_a_drive_that_is_not_polled_yet_waits_for_its_first_poll() -> None:
    engine = interlocks()
    engine.evaluate(views(), 0.0)
    flow = InterlockConfig(id="new", drives=("fan",), require="pump.state == running")
    engine.replace([flow], ["pump"])
    assert blocking(engine, "fan") == ["new"]
    assert engine.evaluate(views("unknown"), 100.0) == []
    assert blocking(engine, "fan") == ["new"], "what is not known permits no start"
    assert engine.evaluate(views("unknown"), 100.0 + FIRST_POLL_GRACE_S - 0.01) == []
    assert engine.evaluate(views("unknown"), 100.0 + FIRST_POLL_GRACE_S) == [("new", False)], "no poll came"


def test_restarted_polls_do_not_trip_an_interlock_that_held_but_a_first_value_can() -> None:
    engine = interlocks()
    engine.evaluate(views(), 0.0)
    engine.replace([InterlockConfig(id="flow", drives=("fan",), require="pump.state == running")], ["pump"])
    assert engine.evaluate(views("unknown"), 50.0) == []
    assert engine.evaluate(views("stopped"), 50.5) == [("flow", False)]


def test_a_reload_gives_no_time_to_a_new_interlock_whose_drive_was_polled_and_is_lost() -> None:
    engine = interlocks()
    engine.evaluate(views(), 0.0)
    engine.replace([InterlockConfig(id="new", drives=("fan",), require="pump.state == running")], ["fan"])
    assert engine.evaluate(views("unknown"), 50.0) == [("new", False)]
