"""Page of the audit trail: its records, their search and the check of the chain."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import page_text


def test_the_audit_trail_shows_user_action_and_frames(stage: Stage, visit: Any, expect: Any) -> None:
    stage.call("drive.stop", drive="pump-1")
    stage.wait(lambda: stage.call("audit.list", drive="pump-1")["items"][0]["outcome"] == "confirmed", "no result")
    page = visit("#/audit")
    page.fill(".filters input[type=search]", "drive.stop")
    entry = page.locator(".entry", has_text=page_text("outcome_confirmed")).filter(has_text="Circulation pump").first
    action = i18n.text("audit.on_drive_stop", subject="Circulation pump")
    expect(entry.locator(".what")).to_have_text(action)
    expect(entry.locator(".user")).to_have_text("tester")
    entry.locator("summary").click()
    expect(entry.locator("ol code").first).to_have_text(re.compile(r"([0-9A-F]{2} )+.* → ([0-9A-F]{2} ?)+"))
    row = f"tester {action} {page_text('outcome_confirmed')}"  # the text of the row
    page.fill(".filters input[type=search]", row)
    expect(page.locator(".entry").first.locator(".ended")).to_have_text(page_text("outcome_confirmed"))
    page.fill(".filters input[type=search]", row + " indeed")
    expect(page.locator(".entry")).to_have_count(0)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_result_that_changed_nothing_is_no_failure(stage: Stage, visit: Any, expect: Any, language: str) -> None:
    """Regression: it was an English word in red, in Chinese too."""
    stage.call("start_inhibits.release", drives=["fan-1"])
    stage.call("start_inhibits.release", drives=["fan-1"])
    page = visit("#/audit", language=language)
    newest = page.locator(".entry", has_text=i18n.text("audit.outcome_unchanged", language)).first.locator(".ended")
    expect(newest).not_to_have_class(re.compile("bad"))


def test_on_a_narrow_phone_a_long_name_of_a_user_stands_beside_the_time_of_the_record(visit: Any) -> None:
    """Regression: the name stood over the last digits of the time."""
    page = visit("#/audit", role="administrator", size=(320, 640))
    entry = page.locator(".entry", has_text="administrator").first
    time_end = entry.locator("time").first.evaluate("""(one) => {
      const text = document.createRange();
      text.selectNodeContents(one);
      return text.getBoundingClientRect().right;
    }""")
    assert time_end < entry.locator(".user").bounding_box()["x"]


def test_a_search_of_the_trail_without_a_match_says_so(stage: Stage, visit: Any, expect: Any) -> None:
    """Regression: an empty box stood there, above the number of all records."""
    stage.call("start_inhibit.release", drive="fan-1")
    page = visit("#/audit")
    page.locator(".entry").first.wait_for()
    none = page.locator("[role=status]", has_text=page_text("search_none"))
    assert none.count() == 0
    page.fill("main input[type=search]", "no record has this text")
    expect(none).to_be_visible()
    expect(page.locator(".audit")).to_be_hidden()


def test_a_command_is_one_row_with_its_value_and_shows_both_records_when_opened(
    stage: Stage, visit: Any, expect: Any
) -> None:
    stage.call("drive.set_frequency", drive="fan-3", frequency_hz=12.5)
    page = visit("#/audit")
    page.fill(".filters input[type=search]", "12.5 Hz")
    rows = page.locator(".entry")
    expect(rows.first.locator(".what")).to_have_text("Set the frequency of Flue gas fan: 12.5 Hz")
    expect(rows).to_have_count(1)
    expect(rows.locator(".ended")).to_have_text(page_text("outcome_acknowledged"))
    rows.locator("summary").click()
    request, result = (stage.call("audit.list", drive="fan-3")["items"][n] for n in (1, 0))
    shown = rows.locator("dl.facts")
    for record, of in ((request, 0), (result, 1)):
        time = datetime.fromtimestamp(record["time_ms"] / 1000, UTC).isoformat(timespec="milliseconds")
        expect(shown.nth(of)).to_contain_text(page_text("entry_n", n=record["n"]))
        expect(shown.nth(of)).to_contain_text(time.replace("+00:00", "Z"))
    assert (request["outcome"], result["of"]) == ("requested", request["n"])


def test_records_of_one_action_are_joined_by_the_number_of_the_request(visit: Any) -> None:
    """Changes of users name no request; a request whose result is not there yet stays a row."""
    page = visit("#/audit")
    numbers = page.evaluate(
        """async () => {
          const m = await import("/static/js/pages/audit.js");
          const record = (n, what, outcome, of = null) => ({ n, what, outcome, of, target: "x", who: { name: "ann" } });
          const entries = [record(9, "drive.run", "requested"), record(8, "user.add", "done"),
            record(7, "drive.stop", "failed", 4), record(6, "user.add", "requested"),
            record(5, "drive.stop", "confirmed"),
            record(4, "drive.stop", "requested"), record(3, "user.add", "requested")];
          return m.joinRecords(entries).map(({ entry, request }) => [entry.n, request?.n ?? null]);
        }"""
    )
    assert numbers == [[9, None], [8, 6], [7, 4], [5, None], [3, None]]


def test_a_label_of_several_faults_is_not_repeated_before_texts_that_have_each_of_them(visit: Any) -> None:
    """A VC660 with two fault bits: "bit 4 + bit 5" stood before "fault bit 4 …; fault bit 5 …"."""
    found = visit("#/fleet").evaluate(
        """async () => {
          const { namesFault, namesLabel } = await import("/static/js/drive/faults.js");
          const words = "fault bit 4, not published; fault bit 5, not published";
          const fault = (label) => ({ label, text: { en: words, zh: words } });
          return [namesLabel(fault("bit 4 + bit 5")), namesLabel(fault("bit 4 + bit 6")), namesLabel(fault("")),
            namesFault(`Fan reports a fault: ${words.slice(6)}`, fault("bit 4 + bit 5")),
            namesFault("Fan reports a fault: bit 4, not published", fault("bit 4 + bit 5")),
            namesFault(words, fault(null))];
        }"""
    )
    assert found == [True, False, True, True, False, True]


def test_the_chain_is_checked_from_the_page(visit: Any, expect: Any) -> None:
    page = visit("#/audit")
    page.click("[data-audit=verify]")
    expect(page.locator(".notice.good")).to_contain_text(page_text("audit_whole", n="").split(":")[0])


def test_an_operator_is_not_shown_the_trail(visit: Any, expect: Any) -> None:
    page = visit("#/audit", role="operator")
    expect(page.locator("main .notice")).to_have_text(page_text("no_right"))
