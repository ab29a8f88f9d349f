"""Sentences of audit records: action, subject, values and outcome in both languages. Pure.

Only the values of ``_details`` are shown; secrets are no part of a record.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from drivebus import i18n
from drivebus.service.alarms.texts import subject_name
from drivebus.service.audit.records import ERROR_TEXT, ERROR_TEXTS, MAX_ERROR_TEXTS, OTHERS
from drivebus.service.config.model import PlantConfig, title_of
from drivebus.service.control.comm_loss_record import CommLossResult
from drivebus.service.live.views import text_json
from drivebus.types import Json
from drivebus.values import Text, bilingual_text

Titles = Mapping[str, Mapping[str, Text]]
"""Titles by the name of the parameter (``drive``, ``group``, ``bus``) and id."""
NO_TITLES: Titles = {}
MAX_VALUES = 8
"""Parameters of a write that are shown by value; the rest is counted in the record only."""
MAX_DRIVES = 6
"""Drives of one command that are named; the rest is counted."""
OUTCOMES = frozenset({"requested", "confirmed", "acknowledged", "refused", "failed", "unknown", "done"})
OTHER_OUTCOMES = frozenset({"counted", "decelerating", "unchanged", *map(str, CommLossResult)})
"""Outcomes that only the audit trail has a sentence for."""
SINGLE_VALUES = ("minimum_hz", "maximum_hz", "minutes", "role", "records", "octets")
"""Parameters with a sentence ``audit.detail.<name>`` of their value alone."""
_PLACEHOLDER = re.compile(r"\{\w+\}")
_LAST_CLAUSE = re.compile(r"(: |：)\{\w+\}$")
"""Reason at the end of the sentence of an outcome: the record of a group has none, as each drive may have its own."""


def titles_of(config: PlantConfig) -> Titles:
    """Return the titles of a plant's drives, groups and buses."""
    return {
        "drive": {drive.id: title_of(drive) for drive in config.drives},
        "group": {group.id: title_of(group) for group in config.groups},
        "bus": {bus.id: title_of(bus) for bus in config.buses},
    }


def described(item: Json, titles: Titles = NO_TITLES) -> Json:
    """Return a record with ``text`` (what was done, to what, with which values) and ``outcome_text``."""
    outcome = _outcome(item, titles)
    return {
        **item,
        "text": text_json(_action(item, titles)),
        "outcome_text": None if outcome is None else text_json(outcome),
    }


def action_name(what: str) -> Text:
    """Return the name of an operation or event; its identifier where the catalogue has none."""
    key = _key("audit.did_", what)
    return bilingual_text(key) if i18n.known(key) else Text(what, what)


def _key(prefix: str, what: str) -> str:
    return prefix + re.sub("[.-]", "_", what)


def _action(item: Json, titles: Titles) -> Text:
    params = item["params"] if isinstance(item.get("params"), dict) else {}
    details = Text.join([*_details(params)], "phrases")
    what, alarms = str(item["what"]), params.get("alarms")
    if what.startswith("alarms.") and isinstance(alarms, list) and len(alarms) == 1:
        what = what.replace("alarms.", "alarm.", 1)
    done = _done_to(what, _subject(item, params, titles))
    return bilingual_text("audit.details", done=done, details=details) if details.en else done


def _done_to(what: str, subject: Text) -> Text:
    """Return an action with its subject, in the word order of each language."""
    if not subject.en:
        return action_name(what)
    key = _key("audit.on_", what)
    if i18n.known(key):
        return bilingual_text(key, subject=subject)
    return bilingual_text("audit.sentence", action=action_name(what), subject=subject)


def _subject(item: Json, params: Mapping[str, Any], titles: Titles) -> Text:
    """Return the title of the target; empty for users who act on themselves."""
    target = str(item.get("target") or "")
    if target == item["who"]["name"]:
        return Text("", "")
    if item["what"] == "incident.note":
        number, _, drive = target.partition("-")
        return bilingual_text("audit.incident", drive=_title("drive", drive, titles), number=number)
    alarm = params.get("alarm_title")
    if isinstance(alarm, Mapping):
        of = _named_drives(params.get("drives"), titles)
        if not of.en:
            of = _named_subjects(params.get("alarm_subjects"), titles)
        return Text.per_language(
            lambda language: " · ".join(filter(None, (of.in_language(language), alarm.get(language))))
        )
    if target == OTHERS:
        return bilingual_text("audit.other_targets")
    drives = params.get("drives")
    if not target and isinstance(drives, list) and len(drives) > 1:
        return bilingual_text("audit.drives", n=len(drives), names=_named_drives(drives, titles))
    if not target:
        return _named_drives(drives, titles)
    kind = next((kind for kind in titles if params.get(kind) == target), item["what"].partition(".")[0])
    return _title(kind, target, titles)


def _named_drives(drives: Any, titles: Titles) -> Text:
    """Return the titles of the first ``MAX_DRIVES`` of these drives, with the number of the others."""
    ids = [str(drive) for drive in drives] if isinstance(drives, list) else []
    titles_shown = Text.join([_title("drive", id, titles) for id in ids[:MAX_DRIVES]], "items")
    return (
        titles_shown
        if len(ids) <= MAX_DRIVES
        else bilingual_text("audit.more", shown=titles_shown, n=len(ids) - MAX_DRIVES)
    )


def _named_subjects(subjects: Any, titles: Titles) -> Text:
    """Return the titles of buses, and the names of files, that alarms without a drive are about."""
    ids = [str(subject) for subject in subjects] if isinstance(subjects, list) else []
    return Text.join([titles.get("bus", {}).get(id) or subject_name(id) for id in ids], "items")


def _title(kind: str, id: str, titles: Titles) -> Text:
    return titles.get(kind, {}).get(id) or Text(id, id)


def _details(params: Mapping[str, Any]) -> Iterator[Text]:
    """Yield the values of a record that an auditor asks for. Values of other types than expected are left out."""
    if isinstance(params.get("frequency_hz"), int | float):
        yield bilingual_text("audit.detail.frequency_hz", value=params["frequency_hz"])
    if params.get("direction") in ("forward", "reverse"):
        yield bilingual_text(f"drives.direction_{params['direction']}")
    if params.get("how") in ("coast", "quick_stop"):
        yield bilingual_text(f"audit.detail.how_{params['how']}")
    if params.get("assume_model") is True:
        yield bilingual_text("audit.detail.assume_model")
    for name in SINGLE_VALUES:
        if isinstance(params.get(name), int | float | str):
            yield bilingual_text(f"audit.detail.{name}", value=_role(params[name]) if name == "role" else params[name])
    for name in ("forward", "reverse"):
        if params.get(name) is False:
            yield bilingual_text(f"audit.detail.{name}")
    values = params.get("values")
    for name, value in [*values.items()][:MAX_VALUES] if isinstance(values, dict) else ():
        yield bilingual_text("audit.detail.value", name=name, value=value)
    if isinstance(values, dict) and len(values) > MAX_VALUES:
        yield Text("…", "…")
    if isinstance(params.get("times"), int) and params["times"] > 1:  # of a count, whose author is a parameter
        yield bilingual_text("audit.detail.times", value=params["times"])
        if params.get("who"):
            yield bilingual_text("audit.detail.who", value=params["who"])
    if params.get("save") is True:
        yield bilingual_text("audit.detail.save")
    if params.get("force") is True:
        yield bilingual_text("audit.detail.force")
    if isinstance(params.get("requested_by"), str):
        yield bilingual_text("audit.detail.requested_by", value=params["requested_by"])
    ended_by = f"plant.session_ended.{params.get('ended_by')}"
    if i18n.known(ended_by):
        yield bilingual_text(ended_by)
    for name in ("reason", "note"):
        if isinstance(params.get(name), str):
            yield bilingual_text(f"audit.detail.{name}", value=params[name])
    if isinstance(params.get("what"), str):
        yield action_name(params["what"])


def _role(role: Any) -> Any:
    """Return the name of a role within a sentence; a role that the catalogue does not have stays as it is."""
    key = f"page.role_{role}"
    if not i18n.known(key):
        return role
    name = bilingual_text(key)
    return Text.from_mapping(name.by_language() | {"en": name.en.lower()})


def _outcome(item: Json, titles: Titles) -> Text | None:
    """Return the text of an outcome: the sentence of an error where the record has it; None without one."""
    outcome, params = item.get("outcome"), item.get("params")
    if not outcome:
        return None
    sentence = params.get(ERROR_TEXT) if isinstance(params, dict) else None
    if _is_text(sentence):
        return Text.from_mapping(sentence)
    parts, params = str(outcome).split(", "), params if isinstance(params, dict) else {}
    is_of_target = len(parts) == 1 and bool(item.get("target")) and params.get("group") != item["target"]
    named = {"drive": item["target"], **params} if is_of_target else {}  # else the drive of an error is not recorded
    by_drive = _outcomes_by_drive(item, parts[0], params)
    recorded = params[ERROR_TEXTS] if isinstance(params.get(ERROR_TEXTS), dict) else {}
    of_parts = [
        _error_texts(part, recorded, by_drive)
        or [([drive for drive, code in by_drive.items() if code == part], _outcome_part(part, named))]
        for part in parts
    ]
    is_of_alarms = str(item["what"]).startswith("alarms.")  # its outcomes are by alarm
    are_named = sum(map(len, of_parts)) > 1 and not is_of_alarms
    shown = [
        Text("…", "…") if index == MAX_ERROR_TEXTS - 1 else _add_drives(drives if are_named else [], text, titles)
        for sentences in of_parts
        for index, (drives, text) in enumerate(sentences[:MAX_ERROR_TEXTS])
    ]
    return Text.join(shown, "clauses")


def _outcomes_by_drive(item: Json, first: str, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the outcome of each drive; the first outcome is that of a target whose followers have theirs."""
    outcomes, target = params.get("outcomes"), item.get("target")
    if not isinstance(outcomes, dict):
        return {}
    return {target: first, **outcomes} if target and params.get("drive") == target else outcomes


def _add_drives(drives: list[str], text: Text, titles: Titles) -> Text:
    """Return a sentence after the titles of the drives that it is about."""
    return bilingual_text("audit.details", done=_named_drives(drives, titles), details=text) if drives else text


def _is_text(value: Any) -> TypeGuard[Json]:
    return isinstance(value, dict) and all(isinstance(value.get(language), str) for language in i18n.LANGUAGES)


def _error_texts(code: str, recorded: Mapping[str, Any], by_drive: Mapping[str, Any]) -> list[tuple[list[str], Text]]:
    """Return the different sentences of an error, each with its drives.

    A drive without one has the only sentence of its error: records of earlier versions name the first drive alone.
    """
    drives = [drive for drive, found in by_drive.items() if found == code]
    first = {drive: recorded[drive] for drive in drives if _is_text(recorded.get(drive))}
    of_others = next(iter(first)) if len(first) == 1 else None
    return [
        ([drive for drive in drives if id in (drive, recorded.get(drive, of_others))], Text.from_mapping(text))
        for id, text in first.items()
    ]


def _outcome_part(code: str, params: Mapping[str, Any]) -> Text:
    if code in OUTCOMES:
        return bilingual_text(f"page.outcome_{code}")
    if code in OTHER_OUTCOMES:
        return bilingual_text(f"audit.outcome_{code}")
    if code == OTHERS:
        return bilingual_text("audit.outcome_others")
    if not i18n.known(code):
        return Text(code, code)
    text, general = bilingual_text(code, **params), _key("audit.outcome_", code)
    text = Text(_LAST_CLAUSE.sub("", text.en), _LAST_CLAUSE.sub("", text.zh))
    if not _PLACEHOLDER.search(text.en):
        return text
    return bilingual_text(general) if i18n.known(general) else bilingual_text("page.outcome_error", code=code)
