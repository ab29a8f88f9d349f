"""Alarm engine: raise, acknowledge, shelve and clear (ISA-18.2), exactly to the tick."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus import i18n
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.errors import NotFound
from drivebus.service import config
from drivebus.service.alarms import Alarm, AlarmEngine, SystemAlarm
from drivebus.service.alarms.engine import MAX_UNACKNOWLEDGED_PER_KEY
from drivebus.service.alarms.texts import signal_name
from drivebus.service.auth.actor import SERVICE_NAME
from drivebus.service.config.model import AlarmConfig, AlarmKind, AlarmPriority
from drivebus.values import Quality, Text, bilingual_text
from fixtures.alarms import FAN, OVERCURRENT, RecordingAlarmLog, current, signal, view

HIGH = AlarmConfig(
    id="overload",
    kind=AlarmKind.ABOVE,
    drives=(),
    signal="output_current",
    threshold=10.0,
    hysteresis=2.0,
    delay_s=3.0,
    priority=AlarmPriority.LOW,
)
ALARMS_PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "alarms.md"
STALE = AlarmConfig(id="old", kind=AlarmKind.STALE, drives=(), delay_s=1.0)


def engine(*settings: AlarmConfig, known: tuple[Alarm, ...] = (), **more: int) -> AlarmEngine:
    return AlarmEngine(settings, [FAN], RecordingAlarmLog().put, known, **more)


def words(changes: list) -> list[str]:
    return [f"{change.action} {change.alarm.setting}" for change in changes]


def run(alarms: AlarmEngine, *views: tuple[float, object]) -> list[str]:
    """Observe views at their seconds; return each change with its second."""
    return [f"{at:g} {word}" for at, observed in views for word in words(alarms.observe(observed, at, int(at * 1000)))]


def test_a_threshold_raises_after_its_delay_to_the_tick_and_clears_below_its_hysteresis() -> None:
    steps = [(n / 10, current(11.0)) for n in range(32)] + [(4.0, current(9.0)), (5.0, current(8.0))]
    assert run(engine(HIGH), *steps) == ["3 raised overload", "5 cleared overload"]


@pytest.mark.parametrize(
    ("kind", "value", "key"),
    [(AlarmKind.ABOVE, 10.5, "alarms.text.above"), (AlarmKind.BELOW, 9.5, "alarms.text.below")],
)
def test_an_alarm_of_a_limit_states_the_value_that_passed_it_and_on_which_side(
    kind: AlarmKind, value: float, key: str
) -> None:
    (change,) = engine(replace(HIGH, kind=kind, delay_s=0.0)).observe(current(value), 0, 0)
    params = {"drive": FAN.title, "value": value, "unit": "A", "threshold": 10, "signal": signal_name("output_current")}
    assert change.alarm.text == bilingual_text(key, **params)


def test_a_value_equal_to_the_threshold_raises_nothing() -> None:
    assert run(engine(replace(HIGH, delay_s=0.0)), (0, current(10.0)), (1, current(10.001))) == ["1 raised overload"]


def test_a_lower_limit_mirrors_an_upper_limit() -> None:
    low = replace(HIGH, kind=AlarmKind.BELOW, delay_s=0.0)
    changes = run(engine(low), (0, current(10.0)), (1, current(9.0)), (2, current(11.9)), (3, current(12.0)))
    assert changes == ["1 raised overload", "3 cleared overload"]


def test_a_value_inside_the_hysteresis_ends_a_delay_that_was_running() -> None:
    views = [(0, current(11.0)), (2.5, current(9.0)), (2.6, current(11.0)), (3.5, current(11.0)), (5.6, current(11.0))]
    assert run(engine(HIGH), *views) == ["5.6 raised overload"]


@pytest.mark.parametrize("quality", [Quality.BAD, Quality.UNCERTAIN])
def test_a_value_without_good_quality_neither_raises_nor_clears_nor_restarts_the_delay(quality: Quality) -> None:
    """The stale alarm is for missing values."""
    not_good = [(1, current(0.0, quality)), (3.5, current(99.0, quality)), (4, current(11.0))]
    assert run(engine(HIGH), (0, current(11.0)), *not_good, (5, current(0.0, quality))) == ["4 raised overload"]


def test_the_delay_of_a_silent_drive_begins_again_when_its_port_is_back() -> None:
    """The drive is not silent for the time in which its port was lost."""
    silent = AlarmConfig(id="silent", kind=AlarmKind.NO_RESPONSE, drives=(), delay_s=10.0)
    alarms, offline = engine(silent), view(presence="offline")
    assert run(alarms, (0, offline), (6, offline)) == []
    alarms.raise_alarm(SystemAlarm.PORT_LOST, "", 7_000, subject=offline.bus, bus=offline.bus, reason="unplugged")
    assert run(alarms, (7, offline), (60, offline)) == []
    alarms.clear_alarm(SystemAlarm.PORT_LOST, "", 61_000, subject=offline.bus)
    assert run(alarms, (61, offline), (70.9, offline), (71, offline)) == ["71 raised silent"]


@pytest.mark.parametrize("value", [None, "text"])
def test_a_missing_or_non_numeric_value_raises_nothing(value: object) -> None:
    alarms = engine(replace(HIGH, delay_s=0.0))
    assert run(alarms, (0, current(value)), (1, view({}))) == []


def test_a_fault_is_raised_with_its_code_and_another_one_is_another_alarm() -> None:
    alarms = engine()
    other = {**OVERCURRENT, "code": 5, "label": "Er.05"}
    views = [(0, view(fault=OVERCURRENT)), (1, view(fault=OVERCURRENT)), (2, view(fault=other)), (3, view())]
    assert run(alarms, *views) == ["0 raised fault", "2 cleared fault", "2 raised fault", "3 cleared fault"]
    assert [alarm.value for alarm in alarms.active()] == [5, 4]
    assert alarms.active()[0].text == Text("Fan reports a fault: Er.05 overcurrent", "风机报告故障：Er.05 过电流")


UNNAMED = view(
    fault={
        "code": UNNAMED_FAULT_CODE,
        "label": "",
        "text": {"en": "a fault whose code is not known", "zh": "代码未知的故障"},
    }
)


def test_a_fault_whose_word_is_read_a_moment_later_is_one_alarm_with_its_name() -> None:
    """The status word shows a fault before the fault word is read; an alarm without a code titled the incident."""
    assert run(engine(), (0, UNNAMED), (1, view(fault=OVERCURRENT)), (2, view(fault=OVERCURRENT))) == ["1 raised fault"]
    alone = engine()
    assert run(alone, (0, UNNAMED), (1, UNNAMED), (2, UNNAMED), (3, UNNAMED)) == ["2 raised fault"]
    assert alone.active()[0].text.en == "Fan reports a fault: a fault whose code is not known", (
        "-1 is no code of the drive"
    )


def test_a_fault_that_is_named_late_stays_one_alarm_which_gets_its_name() -> None:
    """On a full bus the fault word came after 3 s: the same trip was two alarms, the first one "cleared"."""
    alarms = engine()
    found = run(alarms, (0, UNNAMED), (2, UNNAMED), (3, view(fault=OVERCURRENT)), (4, UNNAMED), (5, view()))
    assert found == ["2 raised fault", "3 named fault", "5 cleared fault"]
    (alarm,) = alarms.active()
    assert (alarm.id, alarm.value, alarm.count, alarm.raised_ms) == ("a1", 4, 1, 2000)
    assert alarm.text.en == "Fan reports a fault: Er.04 overcurrent"


def test_a_fault_that_is_named_after_its_acknowledgement_is_to_be_acknowledged_with_its_name() -> None:
    alarms = engine()
    run(alarms, (0, UNNAMED), (2, UNNAMED))
    alarms.acknowledge("a1", "ann", 2500)
    assert run(alarms, (3, view(fault=OVERCURRENT))) == ["3 cleared fault", "3 raised fault"]
    assert [(alarm.value, alarm.acknowledged_ms) for alarm in alarms.active()] == [(4, None)]


def test_a_fault_word_that_is_cleared_before_the_state_is_no_other_fault() -> None:
    """After a reset the fault word was read first: the alarm cleared, and came again without a code."""
    found = run(engine(), (0, view(fault=OVERCURRENT)), (1, UNNAMED), (5, UNNAMED), (6, view()))
    assert found == ["0 raised fault", "6 cleared fault"]


def test_another_fault_has_its_own_delay() -> None:
    late = engine(AlarmConfig(id="trip", kind=AlarmKind.FAULT, drives=(), delay_s=5.0))
    overcurrent, other = view(fault=OVERCURRENT), view(fault={**OVERCURRENT, "code": 5})
    changes = run(late, (0, overcurrent), (5, overcurrent), (6, other), (10.9, other), (11, other))
    assert changes == ["5 raised trip", "6 cleared trip", "11 raised trip"]


def test_a_fault_without_a_text_shows_its_label_and_the_word_fault_once() -> None:
    bare = {"code": 9, "label": "Fu.9", "text": {"en": "fault Fu.9: see the manual", "zh": "故障 Fu.9：见手册"}}
    alarms = engine()
    run(alarms, (0, view(fault=bare)), (1, view(fault={"code": 3})))
    assert [alarm.text.en for alarm in alarms.active()] == [
        "Fan reports a fault: 3",
        "Fan reports a fault: Fu.9: see the manual",
    ]
    assert alarms.active()[1].text.zh == "风机报告故障：Fu.9：见手册"


def test_two_faults_at_once_whose_texts_have_their_labels_show_each_label_once() -> None:
    texts = {"en": "fault bit 4, not published; fault bit 5, not published", "zh": "bit 4 故障；bit 5 故障"}
    alarms = engine()
    run(alarms, (0, view(fault={"code": 4, "label": "bit 4 + bit 5", "text": texts})))
    (alarm,) = alarms.active()
    assert alarm.text.en == "Fan reports a fault: bit 4, not published; fault bit 5, not published"
    assert alarm.text.zh == "风机报告故障：bit 4 故障；bit 5 故障"


def test_a_drive_without_reply_does_not_clear_its_fault() -> None:
    alarms = engine()
    lost = view(presence="offline", state="unknown")
    unknown = view(state="unknown")
    changes = run(alarms, (0, view(fault=OVERCURRENT)), (1, lost), (2, unknown), (3, view(state="stopped")))
    assert [word for word in changes if "fault" in word] == ["0 raised fault", "3 cleared fault"]


def test_a_drive_without_a_state_clears_its_fault_by_a_good_reading_of_it() -> None:
    """DF800 reports no run state."""
    quiet = view({"fault": signal(0)}, state="unknown")
    assert run(engine(), (0, view(fault=OVERCURRENT)), (1, quiet)) == ["0 raised fault", "1 cleared fault"]


def test_no_response_is_raised_at_once_and_after_a_start_with_a_delay() -> None:
    lost, fresh = view(presence="offline", state="unknown"), view(presence="never_seen", state="unknown")
    assert run(engine(), (0, view()), (1, lost), (2, view())) == ["1 raised no_response", "2 cleared no_response"]
    assert run(engine(), (0, fresh), (9.9, fresh), (10, fresh)) == ["10 raised no_response"]


def test_stale_values_raise_an_alarm_and_never_reported_signals_do_not() -> None:
    never = view({"temperature": signal(None, Quality.BAD, source_time_ms=None)})
    old = view(
        {"output_current": signal(3.0, Quality.BAD), "temperature": signal(None, Quality.BAD, source_time_ms=None)}
    )
    alarms = engine(STALE)
    changes = run(alarms, (0, never), (5, never), (6, old), (7, old), (8, current(3.0)))
    assert changes == ["7 raised old", "8 cleared old"]
    assert alarms.active()[0].text.en == "Fan: no fresh value of output current"


def test_a_named_signal_that_is_never_read_is_stale_and_uncertain_is_not() -> None:
    named = replace(STALE, signal="temperature", delay_s=0.0)
    never = view({"temperature": signal(None, Quality.BAD, source_time_ms=None)})
    assert run(engine(named), (0, view({"temperature": signal(1.0, Quality.UNCERTAIN)})), (1, never)) == [
        "1 raised old"
    ]


def test_a_configured_alarm_replaces_the_default_of_its_kind() -> None:
    own = AlarmConfig(
        id="trip", kind=AlarmKind.FAULT, drives=("fan-1",), priority=AlarmPriority.LOW, title=Text("Trip", "")
    )
    alarms = engine(own)
    assert run(alarms, (0, view(fault=OVERCURRENT))) == ["0 raised trip"]
    assert (alarms.active()[0].priority, alarms.active()[0].title) == (AlarmPriority.LOW, Text("Trip", "Trip"))


def test_an_alarm_configured_for_other_drives_ignores_this_one() -> None:
    assert run(engine(replace(HIGH, drives=("pump-1",), delay_s=0.0)), (0, current(99.0))) == []


def test_a_repeated_fault_is_one_entry_that_is_active_again_with_its_count() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)), (1, view()), (2, view(fault=OVERCURRENT)))
    (alarm,) = alarms.active()
    assert (alarm.id, alarm.raised_ms, alarm.cleared_ms, alarm.acknowledged_ms) == ("a2", 2000, None, None)
    assert (alarm.count, alarm.first_id, alarm.first_raised_ms) == (2, "a1", 0)


def test_an_alarm_that_comes_and_goes_200_times_is_one_entry_and_the_log_has_each_occurrence() -> None:
    """It was listed twenty times, and the others were acknowledged in the name of the service."""
    log = RecordingAlarmLog()
    alarms = AlarmEngine([], [FAN], log.put)
    for n in range(200):
        run(alarms, (2 * n, view(fault=OVERCURRENT)), (2 * n + 1, view()))
    (alarm,) = alarms.active()
    assert (alarm.id, alarm.first_id, alarm.count, alarm.first_raised_ms) == ("a200", "a1", 200, 0)
    assert len({alarm.id for alarm in log.alarms}) == 200
    assert all(alarm.acknowledged_by is None for alarm in log.alarms)


def test_a_repeated_alarm_is_acknowledged_by_the_id_that_a_page_showed_a_moment_ago() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)), (1, view()), (2, view(fault=OVERCURRENT)))
    (change,) = alarms.acknowledge("a1", "li", 2500)
    assert (change.alarm.id, change.alarm.acknowledged_by, alarms.acknowledge("a1", "li", 2600)) == ("a2", "li", [])
    run(alarms, (3, view()), (4, view(fault=OVERCURRENT)))
    (alarm,) = alarms.active()
    assert (alarm.id, alarm.count, alarm.first_id) == ("a3", 1, "a3"), "acknowledged: the count begins again"
    with pytest.raises(NotFound):
        alarms.acknowledge("a1", "li", 4500)


def test_an_acknowledgement_is_no_answer_to_an_occurrence_after_it() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    alarms.acknowledge("a1", "li", 500)
    run(alarms, (1, view()), (2, view(fault=OVERCURRENT)))
    assert [(alarm.id, alarm.count, alarm.acknowledged_ms) for alarm in alarms.active()] == [("a2", 1, None)]


def test_two_faults_that_alternate_are_two_entries() -> None:
    alarms = engine()
    other = {**OVERCURRENT, "code": 5}
    for n in range(10):
        run(alarms, (2 * n, view(fault=OVERCURRENT)), (2 * n + 1, view(fault=other)))
    assert [(alarm.value, alarm.count, alarm.cleared_ms) for alarm in alarms.active()] == [
        (5, 10, None),
        (4, 10, 19000),
    ]


def test_a_value_that_passes_its_limit_again_is_one_entry_with_the_newest_value() -> None:
    alarms = engine(replace(HIGH, delay_s=0.0))
    run(alarms, (0, current(11.0)), (1, current(1.0)), (2, current(12.0)))
    assert [(alarm.value, alarm.count) for alarm in alarms.active()] == [(12.0, 2)]


def test_the_alarm_of_a_motor_that_takes_the_place_of_another_repeats_none_of_it() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    alarms.configure([], [FAN], 1, replaced_drives=["fan-1"])
    run(alarms, (2, view(fault=OVERCURRENT)), (3, view()), (4, view(fault=OVERCURRENT)))
    assert [(alarm.id, alarm.count) for alarm in alarms.active()] == [("a3", 2), ("a1", 1)]


def test_an_incident_of_an_earlier_occurrence_is_not_shown_as_that_of_the_newest() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    alarms.attach_incident("a1", "c-1")
    run(alarms, (1, view()), (2, view(fault=OVERCURRENT)))
    assert alarms.active()[0].incident is None


def test_an_incident_that_was_still_being_written_when_its_alarm_repeated_is_not_linked_to_the_repetition() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)), (1, view()), (2, view(fault=OVERCURRENT)))
    assert alarms.attach_incident("a1", "c-1") == []
    assert [(alarm.id, alarm.incident) for alarm in alarms.active()] == [("a2", None)]


def test_an_alarm_leaves_the_list_once_cleared_and_acknowledged_in_either_order() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    (change,) = alarms.acknowledge("a1", "li", 500)
    assert (change.action, change.alarm.acknowledged_ms, change.alarm.acknowledged_by) == ("acknowledged", 500, "li")
    assert alarms.acknowledge("a1", "wang", 600) == []
    assert len(alarms.active()) == 1
    run(alarms, (1, view()), (2, view(fault=OVERCURRENT)), (3, view()))
    assert [alarm.id for alarm in alarms.active()] == ["a2"]
    alarms.acknowledge("a2", "li", 4000)
    assert alarms.active() == []
    with pytest.raises(NotFound) as rejected:
        alarms.acknowledge("a2", "li", 5000)
    assert rejected.value.params == {"alarm": "a2"}


def test_a_cleared_alarm_that_waits_for_its_acknowledgement_is_not_counted_as_active() -> None:
    """Regression: a drive whose fault was reset stayed abnormal until a user acknowledged it."""
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    assert alarms.counts("fan-1") == {"critical": 1}
    run(alarms, (1, view()))
    assert alarms.counts("fan-1") == {}
    assert [alarm.id for alarm in alarms.active()] == ["a1"]


def test_shelving_applies_to_all_alarms_of_a_key_until_its_end_on_the_monotonic_clock() -> None:
    """The UTC time only labels the end."""
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    assert alarms.counts("fan-1") == {"critical": 1}
    (change,) = alarms.shelve("a1", 2, 10.0, 10_000, by="anna", reason="repaired")
    assert (change.action, change.alarm.shelved_until_ms) == ("shelved", 130_000)
    assert (change.alarm.shelved_by, change.alarm.shelved_reason) == ("anna", "repaired")
    run(alarms, (20, view()), (21, view(fault=OVERCURRENT)))
    assert [alarm.shelved_until_ms for alarm in alarms.active()] == [130_000]
    assert alarms.counts("fan-1") == {}
    assert alarms.expire_shelves(129.9) == []
    assert words(alarms.expire_shelves(130.0)) == ["unshelved fault"]
    assert alarms.counts("fan-1") == {"critical": 1}


def test_a_motor_that_takes_the_place_of_another_has_no_shelved_alarm() -> None:
    """A fault of the new motor was hidden for as long as that of the former one was shelved."""
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    alarms.shelve("a1", 60, 0.0, 0, by="anna", reason="to be exchanged")
    alarms.configure([], [FAN], 1, replaced_drives=["fan-1"])
    run(alarms, (2, view(fault=OVERCURRENT)))
    assert alarms.counts("fan-1") == {"critical": 1}


def test_an_alarm_can_be_unshelved_early() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    alarms.shelve("a1", 60, 0.0, 0, by="anna", reason="repaired")
    assert words(alarms.unshelve("a1")) == ["unshelved fault"]
    assert alarms.unshelve("a1") == alarms.expire_shelves(9e9) == []
    with pytest.raises(NotFound):
        alarms.shelve("a7", 1, 0.0, 0, by="anna", reason="repaired")


NO_WATER = Text("Water is there", "有水")


def test_a_system_alarm_is_raised_once_and_cleared_by_the_service() -> None:
    alarms = engine()
    (change,) = alarms.raise_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", 5, subject="no-water", interlock=NO_WATER)
    assert (change.alarm.setting, change.alarm.priority) == ("interlock_trip", AlarmPriority.CRITICAL)
    assert change.alarm.title == Text('Interlock "Water is there"', "联锁“有水”")
    assert change.alarm.text == Text(
        'Fan: interlock "Water is there" does not hold; a stop is requested', "风机：联锁“有水”不成立；正在请求停机"
    )
    assert alarms.raise_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", 6, subject="no-water") == []
    assert words(alarms.raise_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", 6, subject="door")) == [
        "raised interlock_trip"
    ]
    assert words(alarms.clear_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", 7, subject="no-water")) == [
        "cleared interlock_trip"
    ]
    assert alarms.clear_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", 8, subject="no-water") == []


def test_a_configured_id_equal_to_a_system_alarm_hides_none() -> None:
    alarms = engine(replace(HIGH, id="stop_unconfirmed", delay_s=0.0))
    assert run(alarms, (0, current(99.0))) == ["0 raised stop_unconfirmed"]
    assert words(alarms.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, "fan-1", 1)) == ["raised stop_unconfirmed"]
    assert words(alarms.clear_alarm(SystemAlarm.STOP_UNCONFIRMED, "fan-1", 2)) == ["cleared stop_unconfirmed"]
    assert [alarm.cleared_ms for alarm in alarms.active()] == [2, None]


def test_shelving_of_an_earlier_run_lasts_a_day_at_most() -> None:
    before = engine()
    run(before, (0, view(fault=OVERCURRENT)))
    before.shelve("a1", 1440, 0.0, 10**14, by="anna", reason="repaired")
    after = engine(known=tuple(before.active()), first_number=2, now=0.0, now_ms=0)
    assert after.expire_shelves(86_399.0) == []
    assert words(after.expire_shelves(86_400.0)) == ["unshelved fault"]


def test_every_sentence_has_all_its_numbers() -> None:
    alarms = engine(HIGH, STALE, replace(HIGH, id="low", kind=AlarmKind.BELOW, threshold=1e9))
    names = ("subject", "interlock", "reason", "drives", "file", "until", "copy", "motion", "found_hz", "set_hz")
    for kind in SystemAlarm:
        alarms.raise_alarm(kind, "fan-1", 0, **dict.fromkeys(names, "x"))
    silent = replace(current(12.345678), presence="offline", fault=OVERCURRENT)
    old = replace(silent, signals={"output_current": signal(1, Quality.BAD)})
    run(alarms, (0, silent), (3, silent), (4, old), (5, old))
    texts = [
        text for alarm in alarms.active() for text in (alarm.title.en, alarm.title.zh, alarm.text.en, alarm.text.zh)
    ]
    assert len(texts) == 4 * (len(SystemAlarm) + 5)
    found = [text for text in texts if "{" in text or "None" in text or "alarms." in text]
    assert found == [], "add the parameters that only these texts have to names"
    assert "Fan: output current is 12.346 A, above 10 A" in texts


def test_a_drive_that_reports_a_new_fault_each_time_keeps_few_alarms_in_memory_and_all_in_the_log() -> None:
    log = RecordingAlarmLog()
    alarms = AlarmEngine([], [FAN], log.put)
    for n in range(100):
        run(alarms, (2 * n, view(fault={**OVERCURRENT, "code": n})), (2 * n + 1, view()))
    assert [alarm.id for alarm in alarms.active()] == [
        f"a{n}" for n in range(100, 100 - MAX_UNACKNOWLEDGED_PER_KEY, -1)
    ]
    logged = log.alarms
    assert {alarm.acknowledged_by for alarm in logged if alarm.id == "a1"} == {None, SERVICE_NAME}
    assert len({alarm.id for alarm in logged}) == 100


def test_a_raised_alarm_survives_a_restart_and_is_not_raised_twice() -> None:
    before = engine()
    run(before, (0, view(fault=OVERCURRENT)))
    before.shelve("a1", 10, 0.0, 0, by="anna", reason="repaired")
    after = engine(known=tuple(before.active()), first_number=2, now=1000.0, now_ms=60_000)
    assert run(after, (1001, view(fault=OVERCURRENT))) == []
    assert after.expire_shelves(1539.9) == []
    assert words(after.expire_shelves(1540.0)) == ["unshelved fault"]
    assert run(after, (1600, view()), (1601, view(fault=OVERCURRENT))) == ["1600 cleared fault", "1601 raised fault"]
    assert after.active()[0].id == "a2"


def test_after_a_restart_system_alarms_are_cleared_but_unacknowledged() -> None:
    before = engine()
    before.raise_alarm(SystemAlarm.CONTROL_LOST, "fan-1", 5)
    after = engine(known=tuple(before.active()), first_number=2, now_ms=70)
    assert [(alarm.id, alarm.cleared_ms) for alarm in after.active()] == [("a1", 70)]
    assert words(after.raise_alarm(SystemAlarm.CONTROL_LOST, "fan-1", 80)) == ["raised control_lost"]


def test_a_new_configuration_keeps_unchanged_conditions_and_clears_removed_ones() -> None:
    alarms = engine(HIGH, STALE)
    run(alarms, (0, current(11.0)), (2, view({"output_current": signal(11.0, Quality.BAD)})))
    run(alarms, (3, view({"output_current": signal(11.0, Quality.BAD)})))
    assert words(alarms.configure([HIGH], [FAN], 9)) == ["cleared old"]
    assert run(alarms, (10, current(11.0))) == ["10 raised overload"], "its delay went on"
    assert words(alarms.configure([HIGH], [], 11)) == ["cleared overload"]
    assert run(alarms, (12, current(99.0))) == []


def test_an_incident_is_attached_to_its_alarm() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    (change,) = alarms.attach_incident("a1", "c-1")
    assert alarms.active() == [change.alarm]
    assert (change.action, change.alarm.incident) == ("incident", "c-1")


def test_an_alarm_keeps_its_content_through_json() -> None:
    alarms = engine()
    run(alarms, (0, view(fault=OVERCURRENT)))
    assert alarms.as_json() == {"active": [alarm.as_json() for alarm in alarms.active()]}
    assert [Alarm.from_json(item) for item in alarms.as_json()["active"]] == alarms.active()


def test_alarms_are_sorted_by_priority_and_age() -> None:
    alarms = engine(replace(HIGH, delay_s=0.0))
    run(alarms, (0, current(99.0)), (1, replace(current(99.0), presence="offline")))
    run(alarms, (2, replace(current(99.0), presence="offline", fault=OVERCURRENT)))
    alarms.raise_alarm(SystemAlarm.STORAGE_FAILURE, "", 9000)
    assert [alarm.setting for alarm in alarms.active()] == ["fault", "storage_failure", "no_response", "overload"]


@pytest.mark.parametrize("kind", [*AlarmKind, *SystemAlarm])
@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_each_kind_of_alarm_has_a_title_a_text_and_a_remedy(kind: str, language: str) -> None:
    """An alarm needs a response (ISA-18.2), so each kind states what to do."""
    assert all(f"alarms.{part}.{kind}" in i18n.catalogue(language) for part in ("title", "text", "remedy"))


@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_every_list_of_alarm_kinds_that_a_user_reads_is_complete(language: str) -> None:
    """Regression: the Chinese sample of the plant file offered a kind by its former name, which is rejected."""
    sample = (Path(config.__file__).parent / f"sample.{language}.toml").read_text(encoding="utf-8")
    texts = i18n.catalogue(language)
    comments = re.findall(r'^kind = "above" +# (.+)', sample + texts["plant_init.file_alarm"], re.MULTILINE)
    assert [sorted(re.findall("[a-z_]+", comment)) for comment in comments] == [sorted(AlarmKind)] * 2
    page = ALARMS_PAGE.with_suffix(".md" if language == "en" else f".{language}.md").read_text(encoding="utf-8")
    configurable, _, system = page.partition("<!-- system:begin -->")
    assert sorted(kinds_of_table(configurable)) == sorted(AlarmKind)
    assert [kind for kind in AlarmKind if kind not in texts["plant_config.key.alarm.kind"]] == []
    assert kinds_of_table(system) == [*SystemAlarm], "run `make docs`"


def kinds_of_table(page: str) -> list[str]:
    return re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.+?`) \|", page, re.MULTILINE)))


def test_a_raised_alarm_states_what_to_do_also_after_a_restart() -> None:
    alarms = engine()
    (system,) = alarms.raise_alarm(SystemAlarm.CONTROL_LOST, "fan-1", 0)
    assert system.alarm.as_json()["remedy"] == bilingual("alarms.remedy.control_lost")
    (fault,) = alarms.observe(view(fault=OVERCURRENT), 0, 0)
    assert fault.alarm.as_json()["remedy"] == bilingual("alarms.remedy.fault")
    assert Alarm.from_json(fault.alarm.as_json()) == fault.alarm


def bilingual(key: str) -> dict[str, str]:
    return {language: i18n.text(key, language) for language in i18n.LANGUAGES}


def test_the_remedy_that_a_profile_publishes_for_a_fault_is_shown_with_the_alarm() -> None:
    published = {"en": "lengthen the ramp", "zh": "延长加速时间"}
    (change,) = engine().observe(view(fault={**OVERCURRENT, "remedy": published}), 0, 0)
    assert change.alarm.remedy == Text("lengthen the ramp", "延长加速时间")


def test_an_alarm_log_of_an_earlier_version_has_no_remedy_and_is_read() -> None:
    alarms = engine()
    (change,) = alarms.raise_alarm(SystemAlarm.PORT_LOST, "", 0, subject="line-1", reason="")
    old = change.alarm.as_json()
    del old["remedy"]
    assert Alarm.from_json(old) == replace(change.alarm, remedy=Text("", ""))


def test_a_failed_history_does_not_read_as_if_starts_were_refused() -> None:
    alarms = engine()
    (history,) = alarms.raise_alarm(SystemAlarm.STORAGE_FAILURE, "", 0, subject="history", reason="disk is full")
    (trail,) = alarms.raise_alarm(SystemAlarm.AUDIT_FAILURE, "", 0, subject="audit.jsonl", reason="disk is full")
    assert "refused" not in history.alarm.text.en and "starts are refused" in trail.alarm.text.en
    assert "拒绝启动" not in history.alarm.text.zh and "拒绝启动" in trail.alarm.text.zh
