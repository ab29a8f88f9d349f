"""Page of the buses: stations in cable order, decoded frames, and a missing adapter."""

from __future__ import annotations

import re
from typing import Any

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import page_text, unplugged


def test_a_bus_shows_its_stations_in_cable_order_with_their_replies(visit: Any, expect: Any) -> None:
    page = visit("#/buses/fans")
    rows = page.locator(".wide-table tbody tr")
    expect(rows).to_have_count(3)
    assert [row.locator("td").nth(0).inner_text() for row in rows.all()] == [
        "Supply fan",
        "Extract fan",
        "Flue gas fan",
    ]
    expect(rows.first.locator(".replybar .number")).to_have_text(re.compile(r"^[\d.]+ ms / [\d.]+ ms$"))
    names = page.locator(".cable .name").all_inner_texts()
    assert names == [page_text("host"), "Supply fan", "Extract fan", "Flue gas fan"]


def test_the_table_of_stations_keeps_names_on_one_line_on_a_tablet(visit: Any, expect: Any) -> None:
    """Regression: each name took three lines, beside wide columns, so a bus of thirty drives filled ten screens."""
    page = visit("#/buses/pumps", size=(820, 1180))
    name = page.locator(".wide-table tbody td a").first
    expect(name).to_have_text("Circulation pump")
    assert len(name.evaluate("one => [...one.getClientRects()].map(({ top }) => top)")) == 1


def test_decoded_frames_scroll_until_they_are_paused(visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    frames = page.locator(".frames-box .frame")
    expect(frames.nth(10)).to_be_visible()
    assert re.fullmatch(r"([0-9A-F]{2} )+[0-9A-F]{2}", frames.locator(".hex").nth(0).inner_text())
    assert page.locator(".frames-box .frame .frame-text").first.inner_text() != ""
    page.click("[data-frames=pause]")
    expect(page.locator("[data-frames=pause]")).to_have_attribute("aria-pressed", "true")
    held = frames.last.inner_text()
    expect(page.locator(".framelog [role=status]")).not_to_have_text(page_text("paused", n=0))
    assert frames.last.inner_text() == held
    page.click("[data-frames=pause]")
    expect(frames.last).not_to_have_text(held)


def test_frames_are_filtered_by_direction_station_and_content(visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    page.get_by_role("button", name=page_text("frames_sent"), exact=True).click()
    page.select_option(".framelog select", "2")
    expect(page.locator(".frame.sent .station").first).to_have_text("2")
    assert set(page.locator(".frame .station").all_inner_texts()) == {"2"}
    assert page.locator(".frame:not(.sent)").count() == 0
    page.fill(".framelog input[type=search]", "02 03")
    expect(page.locator(".frame .hex").first).to_contain_text("02 03")
    page.fill(".framelog input[type=search]", "no frame says this")
    expect(page.locator(".frames-box .help")).to_have_text(page_text("no_frames"))


def test_a_long_time_between_two_frames_is_named_in_minutes(visit: Any, expect: Any) -> None:
    """Regression: +794000 ms stood over the arrow of its row."""
    common = {"kind": "sent", "station": 1, "hex": "AA BB", "text": {"en": "", "zh": ""}, "error": None, "time_ms": 0}
    frames = [{**common, "n": -2, "time_s": 0.0}, {**common, "n": -1, "time_s": 794.0}]
    page = visit("#/buses", size=(1024, 768))
    page.route("**/api/v1/buses/pumps/frames?**", lambda route: route.fulfill(json={"frames": frames}))
    page.evaluate("location.hash = '#/buses/pumps'")
    page.fill(".framelog input[type=search]", "AA BB")
    expect(page.locator(".frame .gap")).to_have_text(["", "+13 min"])


def test_a_bus_shows_a_missing_adapter_until_it_is_back(stage: Stage, visit: Any, expect: Any) -> None:
    page = visit("#/buses/pumps")
    card = page.locator(".buscard[aria-current]")
    expect(card).to_contain_text(page_text("bus_open"))
    with unplugged(stage, "pumps"):
        expect(card).to_contain_text(page_text("bus_closed"))
        expect(page.locator(".notice.bad").first).to_contain_text(
            page_text("bus_closed_why", port="sim://vc660@1,2?ramp=2")
        )
        reply_text = i18n.text("alarms.text.port_lost", "en", bus="Pump line", reason="")
        expect(page.locator(".banner.alarm a", has_text=reply_text).first).to_be_visible()
        page.evaluate("location.hash = '#/alarms'")
        expect(page.locator(".alarmrow a[href='#/buses/pumps']").first).to_have_text("Pump line")
        page.go_back()
    expect(card).to_contain_text(page_text("bus_open"))


def test_on_a_phone_a_chosen_bus_is_in_sight_and_the_others_are_a_link_away(visit: Any, expect: Any) -> None:
    """Regression: the facts of a bus stood below the cards of all buses."""
    page = visit("#/buses/pumps", size=(360, 740))
    expect(page.locator(".buscard")).to_have_count(2)
    assert page.locator(".buscard").evaluate_all("all => all.map((one) => one.offsetParent !== null)") == [False, True]
    page.get_by_role("link", name=page_text("all_buses")).click()
    expect(page.locator(".buscard").first).to_be_visible()
    page.set_viewport_size({"width": 1440, "height": 900})
    page.locator(".buscard").last.click()
    expect(page.locator(".buscard").first).to_be_visible()
