"""Interlocks over time: delay, edges, and what nobody has read yet."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.service.config.model import InterlockAction, InterlockConfig
from drivebus.service.interlocks.engine import STARTUP_GRACE_S, InterlockEngine
from drivebus.service.live.views import CommLossView, DriveView, SignalView
from drivebus.values import Quality, Text


def view(drive: str, state: str = "running", **signals: tuple[Any, str, Quality]) -> DriveView:
    found = {name: SignalView(value, unit, quality, None, 0.1) for name, (value, unit, quality) in signals.items()}
    return DriveView(
        id=drive,
        title=Text(drive, drive),
        bus="a",
        address=1,
        model="c320",
        grade="simulated",
        capabilities=(),
        groups=(),
        presence="online",
        state=state,
        state_reason=None,
        direction=None,
        fault=None,
        commanded_hz=None,
        minimum_hz=0.0,
        maximum_hz=50.0,
        comm_loss=CommLossView("trips", 2.0, Text("", "")),
        signals=found,
    )


def views(state: str = "running", hz: Any = 25.0, quality: Quality = Quality.GOOD) -> dict[str, DriveView]:
    return {"pump": view("pump", state, output_frequency=(hz, "Hz", quality)), "fan": view("fan")}


def interlocks(require: str = "pump.state == running", **rest: Any) -> InterlockEngine:
    return InterlockEngine([InterlockConfig("flow", ("fan",), require, **rest)])


def ids(found: list[InterlockConfig]) -> list[str]:
    return [one.id for one in found]


def forbidding(found: InterlockEngine, drive: str) -> list[str]:
    return [one.config.id for one in found.violations(drive)]


def said(found: InterlockEngine, language: str) -> str:
    """Why the fan may not start, as it is told."""
    return i18n.text("interlocks.violated", language, **found.violations("fan")[0].message_params)


def test_what_holds_forbids_nothing() -> None:
    found = interlocks()
    assert found.evaluate(views(), 0.0) == []
    assert (forbidding(found, "fan"), found.tripped_stops("fan"), forbidding(found, "pump")) == ([], [], [])


def test_it_forbids_a_start_at_once_and_stops_after_its_delay() -> None:
    found = interlocks(delay_s=2.0)
    found.evaluate(views(), 0.0)
    assert found.evaluate(views("stopped"), 1.0) == []
    assert (forbidding(found, "fan"), found.tripped_stops("fan")) == (["flow"], [])
    assert found.evaluate(views("stopped"), 2.9) == []
    assert found.evaluate(views("stopped"), 3.0) == [("flow", False)]
    assert ids(found.tripped_stops("fan")) == ["flow"]
    assert found.evaluate(views("stopped"), 4.0) == [], "an edge is told once"
    assert ids(found.tripped_stops("fan")) == ["flow"], "and it stops as long as it does not hold"
    assert found.tripped_stops("pump") == []


def test_holding_again_is_told_once_and_begins_the_delay_anew() -> None:
    found = interlocks(delay_s=2.0)
    found.evaluate(views(), 0.0)
    found.evaluate(views("stopped"), 1.0)
    assert found.evaluate(views(), 2.0) == [], "it had not tripped"
    found.evaluate(views("stopped"), 2.5)
    assert found.evaluate(views("stopped"), 4.0) == []
    assert found.evaluate(views("stopped"), 4.5) == [("flow", False)]
    assert found.evaluate(views(), 5.0) == [("flow", True)]
    assert found.evaluate(views(), 6.0) == []
    assert forbidding(found, "fan") == []


def test_one_that_blocks_starts_stops_nothing() -> None:
    found = interlocks(action=InterlockAction.BLOCK_START)
    assert found.evaluate(views("stopped"), 0.0) == [("flow", False)]
    assert (forbidding(found, "fan"), found.tripped_stops("fan")) == (["flow"], [])


def test_a_value_that_is_not_good_does_not_hold() -> None:
    found = interlocks("pump.output_frequency > 5 Hz")
    found.evaluate(views(), 0.0)
    for quality in (Quality.UNCERTAIN, Quality.BAD):
        assert found.evaluate(views(quality=quality), 1.0) == [("flow", False)]
        assert ids(found.tripped_stops("fan")) == ["flow"]
        found.evaluate(views(), 2.0)
    assert found.evaluate(views(hz=None), 3.0) == [("flow", False)]
    found.evaluate(views(), 4.0)
    assert found.evaluate({}, 5.0) == [("flow", False)], "a drive that is no longer there"


def test_an_unknown_state_does_not_hold_either_way() -> None:
    found = interlocks("not pump.state == running")
    found.evaluate(views("stopped"), 0.0)
    assert found.evaluate(views("unknown"), 1.0) == [("flow", False)]


def test_before_the_first_look_nothing_may_start() -> None:
    found = interlocks()
    assert forbidding(found, "fan") == ["flow"] and found.tripped_stops("fan") == []
    assert 'interlock "flow"' in said(found, "en") and "“flow”" in said(found, "zh")
    assert "not read yet" in said(found, "en")


def test_a_restart_does_not_stop_a_drive_because_nothing_has_been_read_yet() -> None:
    """But it forbids starts, and it does not wait for ever."""
    found = interlocks()
    assert found.evaluate(views("unknown"), 100.0) == []
    assert (forbidding(found, "fan"), found.tripped_stops("fan")) == (["flow"], [])
    assert found.evaluate(views("unknown"), 100.0 + STARTUP_GRACE_S - 0.01) == []
    assert found.evaluate(views("unknown"), 100.0 + STARTUP_GRACE_S) == [("flow", False)]
    assert ids(found.tripped_stops("fan")) == ["flow"]


def test_what_is_known_not_to_hold_trips_at_once_after_a_restart() -> None:
    found = interlocks()
    assert found.evaluate(views("stopped"), 100.0) == [("flow", False)]


def test_the_grace_ends_with_the_first_certain_look() -> None:
    found = interlocks()
    found.evaluate(views("unknown"), 100.0)
    found.evaluate(views(), 101.0)
    assert found.evaluate(views("unknown"), 102.0) == [("flow", False)]


def test_a_violation_says_why_in_both_languages() -> None:
    found = interlocks("pump.state == running and pump.output_frequency >= 10 Hz", title=Text("Flow", "流量"))
    found.evaluate(views("stopped", 3.5), 0.0)
    assert said(found, "en") == (
        'interlock "Flow" is not met: pump.state == running required, pump.state is stopped; '
        "pump.output_frequency >= 10 Hz required, pump.output_frequency is 3.5 Hz"
    )
    params = found.violations("fan")[0].message_params
    assert (params["interlock"], params["require"]) == (
        "flow",
        "pump.state == running and pump.output_frequency >= 10 Hz",
    )
    assert all(word in said(found, "zh") for word in ("流量", "3.5 Hz", "联锁"))
    found.evaluate(views("running", 3.5, Quality.BAD), 1.0)
    reasons = found.violations("fan")[0].reasons
    assert [one.en for one in reasons] == [
        "pump.output_frequency >= 10 Hz required, pump.output_frequency has no good value"
    ]


def test_a_reload_keeps_what_unchanged_interlocks_know() -> None:
    found = interlocks(delay_s=2.0)
    found.evaluate(views(), 0.0)
    found.evaluate(views("stopped"), 1.0)
    flow = InterlockConfig("flow", ("fan",), "pump.state == running", delay_s=2.0)
    found.replace([flow, InterlockConfig("more", ("fan",), "pump.state == stopped")])
    assert "more" in forbidding(found, "fan"), "a new one forbids until somebody has looked at it"
    assert found.evaluate(views("stopped"), 3.0) == [("flow", False)]
    found.replace([InterlockConfig("flow", ("fan",), "pump.state == stopped", delay_s=2.0)])
    assert found.evaluate(views("stopped"), 4.0) == [] and forbidding(found, "fan") == []
