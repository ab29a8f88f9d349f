"""Sentences of audit records: what was done, to what, with which values, and how it ended; in both languages."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.service.api.dispatcher import _completed_entry
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.description import described
from drivebus.values import Text

TITLES = {"drive": {"fan-3": Text("Flue gas fan", "引风机")}, "group": {"air": Text("Air", "送引风")}}


def record(action: str, target: str = "", /, *, outcome: str | None = "done", **params: Any) -> dict[str, Any]:
    return {"n": 7, "who": {"name": "ann"}, "what": action, "target": target, "params": params, "outcome": outcome}


def sentences(item: dict[str, Any]) -> tuple[str, str]:
    found = described(item, TITLES)["text"]
    return found["en"], found["zh"]


@pytest.mark.parametrize(
    ("item", "english", "chinese"),
    [
        (
            record("drive.set_frequency", "fan-3", drive="fan-3", frequency_hz=25.0),
            "Set the frequency of Flue gas fan: 25.0 Hz",
            "设定引风机的频率：25.0 Hz",
        ),
        (
            record("drive.run", "fan-3", drive="fan-3", frequency_hz=20.0, direction="reverse", arm_token="***"),
            "Run Flue gas fan: 20.0 Hz, reverse",
            "运行引风机：20.0 Hz，反转",
        ),
        (record("drive.stop", "fan-3", drive="fan-3", how="coast"), "Bus stop of Flue gas fan: coast", None),
        (
            record("drive.stop", "fan-3", drive="fan-3", how="stop", assume_model=True),
            "Bus stop of Flue gas fan: model not checked, name plate read",
            "停止引风机（总线停止）：未核对型号，已查看铭牌",
        ),
        (
            record("parameters.write", "fan-3", drive="fan-3", values={"F0.1": 2.0, "F1.07": "0010H"}, save=True),
            "Write parameters of Flue gas fan: F0.1 = 2.0, F1.07 = 0010H, also to EEPROM",
            "写引风机的参数：F0.1 = 2.0，F1.07 = 0010H，并写入 EEPROM",
        ),
        (
            record("parameters.write", "fan-3", drive="fan-3", values={"P0.05": 3.0}, save=False, force=True),
            "Write parameters of Flue gas fan: P0.05 = 3.0, its warning confirmed",
            "写引风机的参数：P0.05 = 3.0，已确认警告",
        ),
        (
            record(
                "drive.limits", "fan-3", drive="fan-3", minimum_hz=5.0, maximum_hz=40.0, forward=True, reverse=False
            ),
            "Change the limits of Flue gas fan: at least 5.0 Hz, at most 40.0 Hz, reverse not permitted",
            None,
        ),
        (
            record("plant.stop", "", drives=["fan-3", "fan-9"]),
            "Bus stop of all drives: 2 drives (Flue gas fan, fan-9)",
            "停止全部变频器（总线停止）：2 台变频器（引风机、fan-9）",
        ),
        (
            record("group.start", "air", group="air", frequency_hz=30.0),
            "Start group Air: 30.0 Hz",
            "启动组送引风：30.0 Hz",
        ),
        (
            record(
                "alarm.shelve",
                "a4",
                alarm="a4",
                minutes=60,
                reason="bearing",
                drives=["fan-3"],
                alarm_title={"en": "No reply", "zh": "无应答"},
            ),
            "Shelve alarm Flue gas fan · No reply: 60 min, reason: bearing",
            "搁置报警：引风机 · 无应答：60 分钟，原因：bearing",
        ),
        (
            record(
                "alarms.shelve",
                minutes=60,
                reason="cable",
                drives=["fan-3", *(f"m-{n}" for n in range(9))],
                alarm_title={"en": "No reply", "zh": "无应答"},
            ),
            "Shelve alarms Flue gas fan, m-0, m-1, m-2, m-3, m-4 and 4 more · No reply: 60 min, reason: cable",
            "搁置多条报警：引风机、m-0、m-1、m-2、m-3、m-4，另有 4 台 · 无应答：60 分钟，原因：cable",
        ),
        (
            record("alarm.acknowledge", "a5", alarm_subjects=["history"], alarm_title={"en": "Lost", "zh": "断开"}),
            "Acknowledge alarm history · Lost",
            "确认报警：历史数据 · 断开",
        ),
        (record("login", "ann"), "Log in", "登录"),
        (record("user.add", "bob", role="operator"), "Add user bob: role operator", None),
        (
            record("audit.refused", "fan-3", drive="fan-3", what="drive.run"),
            "Refused, because the audit trail can't be written: Flue gas fan: Run",
            "因审计记录无法写入而拒绝：引风机：运行",
        ),
        (record("lease.take", "fan-3", drive="fan-3"), "Take control of Flue gas fan", "取得引风机的控制权"),
        (record("lease.take", "fan-9", drive="fan-9"), "Take control of fan-9", "取得 fan-9 的控制权"),
        (record("drive.stop", "fan-9", drive="fan-9"), "Bus stop of fan-9", "停止 fan-9（总线停止）"),
        (
            record("start_inhibits.release", drives=["fan-3", *(f"m-{n}" for n in range(29))]),
            "Release the start inhibits of 30 drives (Flue gas fan, m-0, m-1, m-2, m-3, m-4 and 24 more)",
            "解除 30 台变频器（引风机、m-0、m-1、m-2、m-3、m-4，另有 24 台）的启动禁止",
        ),
        (
            record("waivers.grant", drives=["fan-3"], reason="bench"),
            "Record waivers for Flue gas fan: reason: bench",
            "记录引风机的豁免：原因：bench",
        ),
        (
            record("incident.note", "000001-fan-3", incident="000001-fan-3", note="bearing"),
            "Note on incident Flue gas fan, no. 000001: bearing",
            "故障记录引风机（第 000001 号）的备注：bearing",
        ),
        (record("user.add", "eva", role="engineer"), "Add user eva: role engineer", "添加用户 eva：角色为工程师"),
        (record("who.knows", "x"), "who.knows x", "who.knows x"),
    ],
    ids=lambda value: value["what"] if isinstance(value, dict) else None,
)
def test_a_record_reads_as_a_sentence_with_its_values(
    item: dict[str, Any], english: str | None, chinese: str | None
) -> None:
    found = sentences(item)
    assert found == (english or found[0], chinese or found[1])


def test_no_value_of_a_secret_or_of_an_unknown_parameter_is_shown() -> None:
    item = record("drive.run", "fan-3", drive="fan-3", arm_token="t0p", password="s3cret", more="x9", frequency_hz=5.0)
    assert not any(word in text for text in sentences(item) for word in ("t0p", "s3cret", "x9"))


def test_values_of_other_types_than_expected_are_left_out() -> None:
    odd = record("drive.run", "fan-9", frequency_hz={"a": 1}, direction=["x"], values="all", reason=7, minutes=None)
    assert sentences(odd)[0] == "Run fan-9"


def test_a_write_of_many_parameters_shows_the_first_ones() -> None:
    many = record("parameters.write", "fan-3", drive="fan-3", values={f"F1.{n:02}": 1.0 for n in range(20)})
    english = sentences(many)[0]
    assert english.endswith("F1.07 = 1.0, …") and "F1.08" not in english


@pytest.mark.parametrize(
    ("outcome", "english", "chinese"),
    [
        ("acknowledged", "Acknowledged, can't be confirmed", "已应答，无法确认"),
        ("confirmed, failed", "Confirmed; Failed", "已确认；失败"),
        ("acknowledged, unknown", "Acknowledged, can't be confirmed; Outcome unknown", "已应答，无法确认；结果未知"),
        ("done, unchanged", "Done; Unchanged", "已完成；未变"),
        ("bus.no_reply", "not done (bus.no_reply)", "未执行（bus.no_reply）"),
        ("runs_on", "the motor kept running", "电机继续运行"),
        (
            "decelerating",
            "sent; the motor was decelerating when the service ended",
            "已发送；服务结束时电机正在减速",
        ),
        ("NotInTheCatalogue", "NotInTheCatalogue", "NotInTheCatalogue"),
    ],
)
def test_an_outcome_reads_as_words(outcome: str, english: str, chinese: str) -> None:
    found = described(record("drive.run", "fan-3", outcome=outcome))
    assert found["outcome_text"] == {"en": english, "zh": chinese}


def outcome_text(item: dict[str, Any]) -> Any:
    return described(item)["outcome_text"]["en"]


def test_the_error_of_a_drive_in_a_group_does_not_name_the_group_as_the_drive() -> None:
    """A record of several drives does not say which one its error is of."""
    lost = "the control lease of the group start was lost"
    assert (
        outcome_text(record("drive.run", "fan-3", outcome="plant.lease_gone")) == f"no start is sent to fan-3: {lost}"
    )
    unnamed = "not done (plant.lease_gone)"
    assert outcome_text(record("group.start", "air", group="air", outcome="plant.lease_gone")) == unnamed
    assert outcome_text(record("plant.stop", "", outcome="plant.lease_gone")) == unnamed
    pulled = described(record("group.start", "air", group="air", outcome="drives.start_not_sent_port"))["outcome_text"]
    assert pulled == {"en": "no start was sent", "zh": "未发送启动命令"}, "each drive may have a reason of its own"
    follower = record("drive.run", "fan-3", drive="fan-3", outcome="confirmed, plant.lease_gone")
    assert outcome_text(follower) == f"Confirmed; {unnamed}"


def test_errors_of_several_drives_are_sentences_and_name_the_drives_where_they_differ() -> None:
    """Regression: "not done (drives.start_failed)" for a sentence that has values."""
    texts = {f"fan-{n}": {"en": f"fan-{n} has tripped", "zh": f"fan-{n} 故障"} for n in range(1, 6)}
    outcomes = {"fan-0": "confirmed", **dict.fromkeys(texts, "drives.start_failed")}

    def outcome(number: int) -> Any:
        params = {"group": "air", "outcomes": outcomes, "error_texts": dict([*texts.items()][:number])}
        codes = "confirmed, drives.start_failed"
        titles = {"drive": {"fan-1": Text("Fan 1", "风机 1")}}
        return described(record("group.start", "air", outcome=codes, **params), titles)["outcome_text"]

    assert outcome(2) == {
        "en": "fan-0: Confirmed; Fan 1: fan-1 has tripped; fan-2: fan-2 has tripped",
        "zh": "fan-0：已确认；风机 1：fan-1 故障；fan-2：fan-2 故障",
    }
    assert outcome(4)["en"].endswith("fan-3: fan-3 has tripped; …"), "what the record may have left out"
    damaged = {"group": "air", "outcomes": outcomes, "error_texts": {"fan-1": 1}}
    found = outcome_text(record("group.start", "air", outcome="drives.start_failed", **damaged))
    assert found == outcome_text(record("group.start", "air", outcome="drives.start_failed"))


def test_each_drive_of_a_command_is_named_with_the_sentence_of_its_error() -> None:
    """Only the first drive of each different sentence was named: the others could have had any of them."""
    tripped, stopped = {"en": "it has tripped", "zh": "故障"}, {"en": "it was stopped", "zh": "已停机"}
    errors = {"fan-1": tripped, "fan-2": stopped, "fan-3": tripped, "fan-4": tripped, "fan-5": stopped}
    outcomes = {drive: {"code": "drives.start_failed", "text": text} for drive, text in errors.items()}
    entry = _completed_entry(
        AuditEntry(what="group.start", target="air", params={"group": "air"}), {"outcomes": outcomes}
    )
    row = record("group.start", "air", outcome=str(entry.outcome), **entry.params)
    assert described(row, {"drive": {"fan-1": Text("Fan 1", "风机 1")}})["outcome_text"] == {
        "en": "Fan 1, fan-3, fan-4: it has tripped; fan-2, fan-5: it was stopped",
        "zh": "风机 1、fan-3、fan-4：故障；fan-2、fan-5：已停机",
    }


TRIPPED = {"code": "drives.start_failed", "text": {"en": "it tripped", "zh": "变频器故障"}}
OFFLINE = {"code": "plant.offline", "text": {"en": "station 3 is offline", "zh": "站 3 离线"}}
CONFIRMED = {"status": "confirmed"}


@pytest.mark.parametrize(
    ("outcomes", "english", "chinese"),
    [
        (
            {"fan-1": TRIPPED, "fan-2": OFFLINE},
            "Fan 1: it tripped; fan-2: station 3 is offline",
            "风机 1：变频器故障；fan-2：站 3 离线",
        ),
        (
            {"fan-1": CONFIRMED, "fan-2": OFFLINE, "fan-3": OFFLINE},
            "Fan 1: Confirmed; fan-2, fan-3: station 3 is offline",
            "风机 1：已确认；fan-2、fan-3：站 3 离线",
        ),
        (
            {"fan-1": CONFIRMED, "fan-2": {"status": "unknown"}, "fan-3": CONFIRMED},
            "Fan 1, fan-3: Confirmed; fan-2: Outcome unknown",
            "风机 1、fan-3：已确认；fan-2：结果未知",
        ),
        ({"fan-1": OFFLINE, "fan-2": OFFLINE}, "station 3 is offline", "站 3 离线"),
        ({"fan-1": CONFIRMED, "fan-2": CONFIRMED}, "Confirmed", "已确认"),
    ],
)
def test_each_outcome_of_a_command_names_its_drives_where_there_is_more_than_one(
    outcomes: Any, english: str, chinese: str
) -> None:
    """Drives were named only where one error had several sentences: "it tripped; station 3 is offline"."""
    titles = {"drive": {"fan-1": Text("Fan 1", "风机 1")}}
    group = _completed_entry(
        AuditEntry(what="group.start", target="air", params={"group": "air"}), {"outcomes": outcomes}
    )
    found = described(record("group.start", "air", outcome=str(group.outcome), **group.params), titles)
    assert found["outcome_text"] == {"en": english, "zh": chinese}
    followers = dict([*outcomes.items()][1:])
    if "status" in outcomes["fan-1"]:  # a command whose own drive fails has no followers
        run = _completed_entry(
            AuditEntry(what="drive.run", target="fan-1", params={"drive": "fan-1"}),
            {"outcome": outcomes["fan-1"], "followers": followers},
        )
        found = described(record("drive.run", "fan-1", outcome=str(run.outcome), **run.params), titles)
        assert found["outcome_text"] == {"en": english, "zh": chinese}, "of a drive and its followers"


def test_a_record_of_an_earlier_version_names_all_drives_with_the_only_sentence_of_their_error() -> None:
    """It has the sentence under the first of them."""
    outcomes = {"fan-1": "confirmed", "fan-2": "plant.offline", "fan-3": "plant.offline"}
    params = {"group": "air", "outcomes": outcomes, "error_texts": {"fan-2": OFFLINE["text"]}}
    found = outcome_text(record("group.start", "air", outcome="confirmed, plant.offline", **params))
    assert found == "fan-1: Confirmed; fan-2, fan-3: station 3 is offline"


def test_the_outcomes_of_several_alarms_have_no_identifiers_of_alarms() -> None:
    """They are by alarm, where those of other commands are by drive."""
    outcomes = {"fan-1:stale": "done", "fan-2:stale": "unchanged"}
    found = outcome_text(record("alarms.acknowledge", outcome="done, unchanged", outcomes=outcomes))
    assert found == "Done; Unchanged"


def test_the_reason_of_a_denied_request_reads_as_words_without_the_values_that_a_record_lacks() -> None:
    """Regression: "not done (auth.no_such_method)"."""
    denied = record("refused", "POST /api/v1/drives/{drive}/limits", outcome="auth.no_such_method", who="@::1", times=1)
    assert described(denied)["text"]["en"] == "Request denied: POST /api/v1/drives/{drive}/limits"
    assert described(denied)["outcome_text"] == {
        "en": "This address does not have the method",
        "zh": "该地址没有此方法",
    }
    for key in ("forbidden", "token_forbidden", "idle", "too_many", "too_large", "too_slow", "not_json", "malformed"):
        assert "(" not in outcome_text(record("refused", "POST /api/v1/stop", outcome=f"auth.{key}"))
    assert outcome_text(record("drive.run", "fan-3", outcome="plant.forbidden")) == "The right was missing"
    assert outcome_text(record("refused", "x", outcome="auth.twice")).startswith("A name occurred twice")


def test_a_count_of_requests_names_their_number_and_author() -> None:
    """The page and the list showed a denied request, not that there were 499 of them, and of whom."""
    denied = record("refused", "POST /api/v1/stop", outcome="auth.idle", who="eve@10.0.0.9", times=499)
    assert described(denied)["text"] == {
        "en": "Request denied: POST /api/v1/stop: 499 times, by eve@10.0.0.9",
        "zh": "请求被拒绝：POST /api/v1/stop：499 次，来自 eve@10.0.0.9",
    }
    stops = described(record("drive.stop", "fan-3", outcome="counted", who="eve@10.0.0.9", times=7))
    assert stops["text"]["en"] == "Bus stop of fan-3: 7 times, by eve@10.0.0.9"
    assert stops["outcome_text"] == {"en": "Recorded as a count", "zh": "仅记录次数"}
    others = described(record("drive.stop", "*", outcome="counted", who="eve", times=5))
    assert others["text"] == {
        "en": "Bus stop of other targets: 5 times, by eve",
        "zh": "停止其他对象（总线停止）：5 次，来自 eve",
    }
    anonymous = described(record("refused", "*", outcome="*", who="", times=5))
    assert anonymous["text"]["en"] == "Request denied: other targets: 5 times"
    assert anonymous["outcome_text"] == {"en": "Various reasons", "zh": "多种原因"}
    assert outcome_text(record("refused", "x", outcome="plant.too_many_commands", who="eve@", times=7)) == (
        "The user's commands were refused too often"
    )


def test_an_event_without_an_outcome_has_no_outcome_text() -> None:
    assert described(record("audit.opened", outcome=None))["outcome_text"] is None


@pytest.mark.parametrize(
    ("alarms", "action"), [(["a1"], "Acknowledge alarm Fault"), (["a1", "a2"], "Acknowledge alarms Fault")]
)
def test_one_alarm_that_is_acknowledged_in_the_list_is_recorded_as_one(alarms: list[str], action: str) -> None:
    params = {"alarms": alarms, "alarm_title": {"en": "Fault", "zh": "故障"}}
    item = {"what": "alarms.acknowledge", "target": "", "who": {"name": "ann"}, "params": params, "outcome": "done"}
    assert described(item)["text"]["en"] == action
