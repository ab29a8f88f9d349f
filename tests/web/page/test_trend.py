"""A trend: drawing of samples on the screen, and its gestures."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import expecting, go_to, unplugged, wait_for_event, wait_until

NOTHING = "–"
MODULES = "/static/js/trend/"


def module(page: Any, name: str, call: str) -> Any:
    """Return the result of a pure function of the page."""
    return page.evaluate(f"async () => {{ const m = await import('{MODULES}{name}.js'); return {call}; }}")


SERIES = {
    "t": [0, 1000, 2000, 3000, 4000, 5000],
    "min": [9, 9, None, 11, 12, 12],
    "mean": [10, 10, None, 12, 13, 13],
    "max": [11, 11, None, 13, 14, 14],
    "q": [0, 0, 2, 1, 0, 2],
}


def test_gaps_and_bad_values_are_not_drawn(scripts: Any) -> None:
    """A gap is null in every column, and so is a received value of bad quality."""
    found = module(scripts, "columns", f"m.split({json.dumps(SERIES)})")
    assert [value is None for value in found["high"]] == [False, False, True, False, False, True]
    assert found["good"] == [10, 10, None, None, 13, None]
    assert found["low"][5] is None and found["high"][5] is None


def test_a_chart_is_loaded_where_the_browser_names_no_valid_language(scripts: Any) -> None:
    """Regression: WebKit on a machine with the locale "C" showed neither the history nor the trend of a drive."""
    page = scripts.context.new_page()
    page.add_init_script("Object.defineProperty(navigator, 'language', { value: 'C', configurable: true })")
    page.goto(scripts.url)
    assert module(page, "chart", "typeof m.Chart") == "function"
    page.close()


def test_the_first_label_of_an_empty_chart_is_not_cut_off(scripts: Any) -> None:
    """Without values there is no value axis beside it, so half of the label would lie outside."""
    call = """(() => {
        const host = document.body.appendChild(document.createElement("div"));
        host.style.width = "300px";
        const chart = new m.Chart(host, { selected() {}, pointed() {}, drawn() {} });
        const plot = chart.build([{ tag: "a.b", label: "b", unit: "Hz", hue: 0 }], { height: 200, locale: "en-GB" });
        chart.draw([[], [], [], [], []], { from: 0, to: 60_000 }, { markers: [], strips: [], states: [] });
        const room = plot.bbox.left / devicePixelRatio;
        plot.ctx.font = getComputedStyle(host).font;
        chart.destroy();
        host.remove();
        return [room, plot.ctx.measureText("1970-01-01").width * 12 / 16 / 2];
    })()"""
    room, half = module(scripts, "chart", call)
    assert room >= half > 20


def test_an_uncertain_stretch_is_its_own_line_that_reaches_its_good_neighbours(scripts: Any) -> None:
    found = module(scripts, "columns", f"m.split({json.dumps(SERIES)})")
    assert found["uncertain"] == [None, None, None, 12, 13, None]


def test_two_tags_keep_their_own_moments_and_gaps(scripts: Any) -> None:
    """A moment at which only another tag was read is no gap (undefined), unless it is beside a gap (null)."""
    first = {"t": [0, 2000], "min": [1, 2], "mean": [1, 2], "max": [1, 2], "q": [0, 0]}
    second = {"t": [1000, 2000], "min": [None, 5], "mean": [None, 5], "max": [None, 5], "q": [2, 0]}
    columns = f"m.table(['a', 'b'], {json.dumps({'a': first, 'b': second})})"
    call = f"{columns}.map(c => c.map(v => v === undefined ? 'none' : v))"
    found = module(scripts, "columns", call)
    assert found[0] == [0, 1000, 2000]
    assert found[3] == [1, "none", 2] and found[7] == [None, None, 5]


def test_no_line_is_drawn_through_a_gap_at_the_moments_of_another_tag(scripts: Any) -> None:
    """Regression: after a trip a line fell slowly to 0 Hz, while nothing was known for a minute."""
    gap = {"t": [0, 2000, 8000], "min": [45, None, 0], "mean": [45, None, 0], "max": [45, None, 0], "q": [0, 2, 0]}
    other = {"t": [1000, 4000, 6000, 9000], "min": [5] * 4, "mean": [5] * 4, "max": [5] * 4, "q": [0] * 4}
    columns = f"m.table(['a', 'b'], {json.dumps({'a': gap, 'b': other})})"
    found = module(scripts, "columns", f"{columns}.map((c) => c.map((v) => v === undefined ? 'none' : v))")
    assert found[0] == [0, 1000, 2000, 4000, 6000, 8000, 9000]
    assert found[3] == [45, None, None, None, None, 0, "none"]
    assert found[1] == [45, "none", None, "none", "none", 0, "none"], "its band knows the moments of its own tag"


def test_live_values_follow_the_last_stored_sample_and_a_lost_connection_is_a_gap(scripts: Any) -> None:
    live = [{"t": 4500, "v": 99, "q": 0}, {"t": 6000, "v": 14, "q": 0}, {"t": 6500, "v": None, "q": 2}]
    found = module(scripts, "columns", f"m.extended({json.dumps(SERIES)}, {json.dumps(live)})")
    assert found["t"][-3:] == [5000, 6000, 6500] and found["mean"][-2:] == [14, None]


def test_the_statistics_of_a_window_exclude_unusable_values(scripts: Any) -> None:
    found = module(scripts, "columns", f"m.summary({json.dumps(SERIES)}, {{from: 1000, to: 5000}})")
    assert found == {"low": 9, "mean": pytest.approx((10 + 12 + 13) / 3), "high": 14}
    assert module(scripts, "columns", f"m.summary({json.dumps(SERIES)}, {{from: 5000, to: 9000}})") is None


@pytest.mark.parametrize(
    ("moment", "value", "quality"), [(1400, 10, 0), (2100, None, 2), (3300, 12, 1), (4900, None, 2)]
)
def test_a_cursor_reads_the_nearest_sample_with_its_quality(
    scripts: Any, moment: int, value: Any, quality: int
) -> None:
    found = module(scripts, "columns", f"m.valueAt({json.dumps(SERIES)}, {moment}, 1500)")
    assert (found["value"], found["q"]) == (value, quality)


def test_a_cursor_far_from_any_sample_reads_nothing(scripts: Any) -> None:
    assert module(scripts, "columns", f"m.valueAt({json.dumps(SERIES)}, 9000, 1500)") is None


def test_stretches_of_uncertain_and_bad_quality_are_shown_below(scripts: Any) -> None:
    found = module(scripts, "columns", f"m.stretches({json.dumps(SERIES)}, 9000)")
    assert [(stretch["from"], stretch["to"], stretch["q"]) for stretch in found] == [
        (2000, 3000, 2),
        (3000, 4000, 1),
        (5000, 9000, 2),
    ]


def test_after_the_port_was_lost_there_is_a_gap_up_to_now_also_on_a_page_that_is_loaded_later(scripts: Any) -> None:
    """The lines ended in the middle of the chart, without the bar that says why."""
    stored = {name: column[:5] for name, column in SERIES.items()}
    live = [{"t": 3900, "v": 13, "q": 2}]  # the last value that was read, before the last stored point of a second
    found = module(scripts, "columns", f"m.stretches(m.extended({json.dumps(stored)}, {json.dumps(live)}), 9000)")
    assert found[-1] == {"from": 4001, "to": 9000, "q": 2}


def test_zooming_keeps_the_moment_under_the_pointer_and_stays_between_5_s_and_11_years(scripts: Any) -> None:
    found = module(scripts, "window", "m.zoomed({from: 0, to: 100000}, 0.5, 25000)")
    assert found == {"from": 12500, "to": 62500}
    tiny = module(scripts, "window", "m.zoomed({from: 0, to: 6000}, 0.01, 3000)")
    assert tiny["to"] - tiny["from"] == 5000 and tiny["from"] < 3000 < tiny["to"]
    huge = module(scripts, "window", "m.zoomed({from: 0, to: 300 * 86400000}, 1000)")
    assert huge["to"] - huge["from"] == 4000 * 86_400_000


def test_a_fetch_is_wider_than_the_window_but_ends_now(scripts: Any) -> None:
    assert module(scripts, "window", "m.padded({from: 1000000, to: 1100000}, 1110000)") == {
        "from": 975000,
        "to": 1110000,
    }


@pytest.mark.parametrize(
    ("window", "is_covered"),
    [
        ("{from: 10, to: 90}", True),
        ("{from: -1, to: 90}", False),
        ("{from: 10, to: 130}", False),
        ("{from: 40, to: 60}", False),
    ],
)
def test_a_fetched_window_serves_what_lies_within_it_unless_it_is_too_coarse(
    scripts: Any, window: str, is_covered: bool
) -> None:
    """The last case shows a fifth of the fetched window, for which finer points exist."""
    assert module(scripts, "window", f"m.covers({{from: 0, to: 100}}, {window}, 1000)") is is_covered


@pytest.mark.parametrize(
    ("span", "message"),
    [
        (61_000, "1 min 1 s"),
        (90_061_000, "1 d 1 h"),
        (-500, "−0.5 s"),
        (0, "0 s"),
        (599_970, "10 min"),
        (12_300, "12.3 s"),
    ],
)
def test_a_duration_is_shown_with_its_two_largest_units(scripts: Any, span: int, message: str) -> None:
    """Regression: a chart that two fingers brought back to ten minutes showed "9 min 60 s"."""
    scripts.evaluate("import('/static/js/i18n.js').then((m) => m.loadLanguage('en'))")
    assert module(scripts, "../format", f"m.spanText({span})") == message


def test_a_tick_of_a_window_dragged_to_a_part_of_a_millisecond_has_its_whole_second(scripts: Any) -> None:
    """Regression: after a zoom the ticks of 13:00:00 were named 12:59:59."""
    at = "new Date(2026, 10, 26, 13).getTime() - 0.4"
    assert module(scripts, "time-labels", f"m.timeLabel({at}, 60_000, 'en-GB')") == "13:00:00"
    assert module(scripts, "time-labels", f"m.dayLine({at.replace('13', '0')}, 60_000, 'en-GB')") == "26 Nov"


LINES = [
    {"tag": f"d.{name}", "unit": unit}
    for name, unit in [("hz", "Hz"), ("a", "A"), ("v", "V"), ("set", "Hz"), ("fault_word_0", "")]
]
FAULT_WORD = {"t": [0, 1000, 2000], "min": [0, 0, 64], "mean": [0, 32, 64], "max": [0, 64, 64], "q": [0, 0, 0]}


@pytest.mark.parametrize(
    ("hidden", "recent", "units"),
    [
        ([], [], ["Hz", "A"]),
        (["d.a"], [], ["Hz", "V"]),
        ([], ["d.v"], ["V", "Hz"]),
        (["d.hz", "d.a", "d.v", "d.set"], [], []),
    ],
)
def test_a_chart_has_the_axes_of_two_units_and_none_for_a_word(
    scripts: Any, hidden: list[str], recent: list[str], units: list[str]
) -> None:
    """Regression: an incident's chart of 18 signals had nine axes."""
    call = f"m.axisUnits({json.dumps(LINES)}, new Set({json.dumps(hidden)}), {json.dumps(recent)})"
    assert module(scripts, "lines", call) == units


def test_a_chart_of_many_signals_begins_with_those_of_two_units(scripts: Any) -> None:
    found = module(scripts, "lines", f"m.firstLines({json.dumps(LINES)})")
    assert [line["tag"] for line in found] == ["d.hz", "d.a", "d.set"]


def test_a_chart_of_nothing_but_words_shows_them(scripts: Any) -> None:
    """Regression: the chart of a DF800, whose manual gives its values no unit, was empty without a word."""
    words = [line for line in LINES if not line["unit"]]
    assert words and module(scripts, "lines", f"m.firstLines({json.dumps(words)})") == words


def test_a_fault_word_has_steps_and_values_but_no_mean(scripts: Any) -> None:
    """Regression: a fault word of 64 that had been 0 was shown as 32, a bit that no drive had set."""
    found = module(scripts, "columns", f"m.split({json.dumps(FAULT_WORD)}, {{isWord: true}})")
    assert found["good"] == [0, None, 64] and found["high"] == [0, 64, 64] and found["low"] == [0, 0, 64]
    window = "{from: 0, to: 9000}"
    assert module(scripts, "lines", f"m.valuesOfWord({json.dumps(FAULT_WORD)}, {window})") == [0, None, 64]
    word = json.dumps(LINES[-1])
    assert module(scripts, "readout", f"m.sampleAt({word}, {json.dumps(FAULT_WORD)}, 1000)")["value"] is None
    hertz = json.dumps(LINES[0])
    assert module(scripts, "readout", f"m.sampleAt({hertz}, {json.dumps(FAULT_WORD)}, 1000)")["value"] == 32


# --- on the screen ------------------------------------------------------------------------------------------------

STEADY = "fan-1.output_frequency"


BEGIN_MS = 1_700_000_000_000
PAST = f"from={BEGIN_MS}&to={BEGIN_MS + 3_600_000}"
"""Hour in 2023 for the address of a trend: no live value is drawn there."""


def fulfill_history(route: Any, values: list[float | None], quality: list[int], *tags: str) -> None:
    """Answer with 600 samples in the requested time, the same for each tag."""
    query = dict(part.split("=") for part in route.request.url.partition("?")[2].split("&"))
    begin, end = int(query["from_ms"]), int(query["to_ms"])
    at = [begin + (end - begin) * n // 600 for n in range(600)]
    series = {"t": at, "min": values, "mean": values, "max": values, "q": quality}
    route.fulfill(json={"resolution": "1s", "series": dict.fromkeys(tags, series)})


def answer(route: Any) -> None:
    """Answer with a year of history at 20 Hz: good, bad from one third on, uncertain from two thirds on."""
    third = [0 if n < 200 else 2 if n < 400 else 1 for n in range(600)]
    fulfill_history(route, [None if quality == 2 else 20.0 for quality in third], third, STEADY)


COLOURED = """([x0, x1]) => {
  const canvas = document.querySelector('.trend-plot canvas');
  const over = document.querySelector('.u-over').getBoundingClientRect(), box = canvas.getBoundingClientRect();
  const [from, to] = [x0, x1].map((share) => Math.round(over.left - box.left + share * over.width));
  const probe = document.createElement('canvas').getContext('2d');
  probe.fillStyle = getComputedStyle(canvas).getPropertyValue('--trace-1'); probe.fillRect(0, 0, 1, 1);
  const want = probe.getImageData(0, 0, 1, 1).data;
  const height = Math.round(over.height) - 12;
  const data = canvas.getContext('2d').getImageData(from, Math.round(over.top - box.top), to - from, height).data;
  const columns = new Set();
  for (let at = 0; at < data.length; at += 4)
    if (data[at + 3] > 200 && [0, 1, 2].every((c) => Math.abs(data[at + c] - want[c]) < 60))
      columns.add((at / 4) % (to - from));
  return columns.size / (to - from);
}"""
"""Script: share of a stretch's pixel columns that contain the line, without the quality strips."""


def test_a_bad_stretch_is_empty_and_an_uncertain_one_is_dashed(visit: Any) -> None:
    page = visit("#/fleet")
    page.route("**/api/v1/history/trend?*", answer)
    page.evaluate(f"location.hash = '#/history?tags={STEADY}&{PAST}'")
    page.locator(".trend-window:has-text('2023-11-14')").wait_for()
    # What is fetched begins and ends a quarter of the window beyond it: bad from 1/4 to 3/4 of what is shown.
    page.wait_for_function(f"(stretch) => ({COLOURED})(stretch) > 0.9", arg=[0.02, 0.2])
    assert page.evaluate(COLOURED, [0.3, 0.7]) == 0
    assert 0.2 < page.evaluate(COLOURED, [0.8, 0.98]) < 0.9


def test_the_values_at_the_pointer_stand_beside_it_and_a_bad_stretch_has_none(visit: Any) -> None:
    page = visit("#/fleet")
    page.route("**/api/v1/history/trend?*", answer)
    page.evaluate(f"location.hash = '#/history?tags={STEADY}&{PAST}'")
    page.locator(".trend-readout tbody .more >> text=20.00").first.wait_for()
    box, tip = page.locator(".u-over").bounding_box(), page.locator(".trend-tip")
    page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + 60)
    expecting()(tip).to_contain_text("20.00 Hz")
    expecting()(tip.locator("time")).to_have_text(re.compile(r"2023-11-14 .*:[0-9]{2}\.[0-9]{3}"))
    assert tip.bounding_box()["x"] > box["x"] + 0.1 * box["width"]
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60)
    expecting()(tip.locator("b")).to_have_text(NOTHING)
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 60)
    expecting()(tip.locator("b")).to_have_text(re.compile(r"20\.00 Hz\s*\?"))
    tip_box = tip.bounding_box()
    assert tip_box["x"] + tip_box["width"] < box["x"] + 0.9 * box["width"]
    page.mouse.move(5, 5)
    expecting()(tip).to_have_count(0)


def test_the_gestures_are_named_below_the_chart_until_they_are_closed(visit: Any) -> None:
    page = visit(f"#/history?tags={STEADY}")
    drag = page.get_by_text(i18n.text("page.gesture_drag", "en"))
    expecting()(drag).to_be_visible()
    page.click(".gestures summary")
    expecting()(drag).to_be_hidden()
    page.wait_for_function("() => localStorage.getItem('drivebus.gesture_help') === 'false'")  # after the redraw
    page.reload()
    page.locator(".gestures summary").wait_for()
    expecting()(drag).to_be_hidden()


def test_the_trend_of_a_drive_stands_below_its_values_beside_the_control_panel(visit: Any) -> None:
    page = visit("#/drive/fan-1", size=(1440, 900))
    values, details, control = (page.locator(f".{name}") for name in ("values", "drivedetails", "drivecontrol"))
    details.wait_for()
    above, below, beside = values.bounding_box(), details.bounding_box(), control.bounding_box()
    assert below["y"] - (above["y"] + above["height"]) < 40
    assert below["x"] == above["x"] and beside["y"] + beside["height"] > below["y"] + 20
    page.set_viewport_size({"width": 360, "height": 780})
    assert control.bounding_box()["y"] < details.bounding_box()["y"]


HALF = re.compile(r"· (2[6-9]|3[0-4]) min")


def window_of(page: Any) -> Any:
    return page.locator(".trend-window")


def test_an_event_whose_sentence_names_its_drive_names_it_once(scripts: Any) -> None:
    texts = ("fan-1: no reply", "run at 30 Hz")
    events = [{"drive": drive, "text": text} for drive in ("fan-1", None) for text in texts]
    shown = scripts.evaluate("(all) => import('/static/js/trend/events.js').then((m) => all.map(m.eventText))", events)
    assert shown == ["fan-1: no reply", "fan-1 run at 30 Hz", "fan-1: no reply", "run at 30 Hz"]


def test_the_kind_of_an_event_that_its_sentence_names_is_not_read_twice(scripts: Any) -> None:
    """A screen reader read "fault fault OC: overcurrent"."""
    cases = [
        ("fault", "fault OC: overcurrent"),
        ("fault", "Feed pump reports a fault: overcurrent"),
        ("fault", "OC: overcurrent"),
        ("fault", "default settings restored"),
        ("stop", "Bus stop of the whole plant"),
        ("command", "run at 30 Hz"),
    ]
    named = scripts.evaluate(
        """async (cases) => {
      const [events, i18n] = await Promise.all(["trend/events", "i18n"].map((one) => import(`/static/js/${one}.js`)));
      await i18n.loadLanguage("en");
      const all = cases.map(([kind, text]) => events.namesKind(kind, text));
      await i18n.loadLanguage("zh");
      all.push(events.namesKind("fault", "给水泵报告故障：过电流"), events.namesKind("fault", "过电流"));
      await i18n.loadLanguage("en");
      return all;
    }""",
        cases,
    )
    assert named == [True, True, False, False, True, False, True, False]


CENTRES = """(row) => [...row.cells].slice(0, 2).map((cell) => {
  const range = document.createRange();
  range.selectNodeContents(cell);
  const { top, height } = range.getBoundingClientRect();
  return top + height / 2;
})"""


def test_on_a_phone_the_value_of_a_trend_stands_beside_the_name_of_its_signal(visit: Any) -> None:
    """It stood above: a rule for every table outweighed that of this one."""
    page = visit("#/history?tags=fan-1.output_frequency", size=(375, 812))
    page.locator(".trend-readout .value").first.wait_for()
    name, value = page.locator(".trend-readout tbody tr").first.evaluate(CENTRES)
    assert abs(name - value) < 4


def test_gestures_zoom_pan_and_measure(stage: Stage, visit: Any) -> None:
    """Drag, wheel, keys and cursors; a window of the past does not follow live values."""
    expect = expecting()
    page = visit(f"#/history?tags={STEADY},fan-1.output_current")
    over, following, window = page.locator(".u-over"), page.locator("[data-trend=live]"), window_of(page)
    expect(following).to_have_attribute("aria-pressed", "true")
    expect(window).to_have_text(re.compile("· 1 h$"))
    box = over.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 100 + box["width"] / 2, box["y"] + 60, steps=3)
    page.mouse.up()
    expect(window).to_have_text(HALF)
    expect(following).to_have_attribute("aria-pressed", "false")
    before = window.inner_text()
    page.keyboard.down("Shift")
    page.mouse.wheel(0, -200)
    page.keyboard.up("Shift")
    expect(window).not_to_have_text(before)
    expect(window).to_have_text(HALF)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -200)
    page.keyboard.up("Control")
    expect(window).to_have_text(re.compile("· 1\\d min"))
    before = window.inner_text()
    page.locator(".trend-plot").press("ArrowLeft")
    expect(window).not_to_have_text(before)
    page.locator(".trend-plot").press("Backspace")
    expect(window).to_have_text(re.compile("· 1 h$"))
    expect(following).to_have_attribute("aria-pressed", "true")


RECORD_TEXTS = """() => {
  window.texts = new Set();
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
    window.texts.add(text);
    return fillText.call(this, text, ...place);
  };
}"""


def test_the_scale_of_a_stopped_drive_ends_at_its_highest_frequency_and_that_of_its_voltage_at_1(visit: Any) -> None:
    """Regression: both went from 0 to 100, as if the drive could reach 100 Hz and 100 V."""
    tags = ("fan-1.output_frequency", "fan-1.dc_bus_voltage")
    page = visit("#/fleet")
    page.locator(".tile").first.wait_for()  # the highest frequency of the drive is known
    page.evaluate(RECORD_TEXTS)
    page.route("**/api/v1/history/trend?**", lambda route: fulfill_history(route, [0.0] * 600, [0] * 600, *tags))
    go_to(page, f"history?tags={','.join(tags)}&{PAST}")
    wait_until(page, lambda: {"40", "0.8"} <= set(page.evaluate("[...window.texts]")), "no scale of 45 Hz and 1 V")
    assert "100" not in page.evaluate("[...window.texts]")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_window_without_values_says_so_and_names_no_resolution(visit: Any, language: str) -> None:
    """Regression: before the first sample each point was "1 h or more", in a window of 3 min."""
    expect = expecting()
    page = visit(f"#/history?tags={STEADY}", language=language)
    summary, empty = page.locator(".trend-summary"), i18n.text("page.trend_empty", language)
    expect(summary).to_contain_text(i18n.text("page.points_1s", language))
    for _ in range(3):
        page.locator(".trend-plot").press("PageUp")
    expect(summary).to_contain_text(empty)
    expect(summary).not_to_contain_text(i18n.text("page.points_1h", language))
    page.locator(".trend-plot").press("End")
    expect(summary).not_to_contain_text(empty)


def test_two_cursors_show_the_time_between_two_moments(stage: Stage, visit: Any) -> None:
    expect = expecting()
    page = visit(f"#/history?tags={STEADY}")
    span = page.get_by_role("group", name=i18n.text("page.span", "en"))
    span.get_by_role("button", name=i18n.text("page.span_60", "en"), exact=True).click()
    expect(window_of(page)).to_have_text(re.compile("· 1 min$"))
    page.click("[data-trend=cursors]")
    head = page.locator(".trend-readout caption")
    expect(head).to_contain_text("20 s")
    cursor = page.locator(".trend-cursor[data-name=B]")
    cursor.wait_for()  # the chart shows it one frame after the caption
    cursor.press("Shift+ArrowRight")
    expect(head).to_contain_text("23 s")


def test_commands_to_a_drive_are_marked_in_its_trend(stage: Stage, visit: Any) -> None:
    """The trend on the drive's page is live; the stop is marked, listed, and leads to its moment."""
    expect = expecting()
    stage.call("drive.stop", drive="pump-1")
    wait_for_event(stage, "pump-1", "stop")
    page = visit("#/drive/pump-1", language="zh")
    row = page.locator(".trend-readout tbody tr").first
    expect(row.locator("td .number")).to_have_text("0.00")
    expect(row.locator("td.more").nth(2)).to_have_text(re.compile(r"\d"))
    page.click(".trend-events summary")
    event = page.locator(".trend-events .event-stop").first
    expect(event).to_contain_text("循环泵")
    before = window_of(page).inner_text()
    event.click()
    expect(window_of(page)).not_to_have_text(before)


def test_signals_are_chosen_stored_in_the_address_and_exported_as_a_file(stage: Stage, visit: Any) -> None:
    page = visit("#/history?tags=fan-1.output_frequency")
    page.locator(".trend-plot canvas").wait_for()
    page.click(".picker summary")
    page.fill(".picker input[type=search]", "feed pump output current")
    page.locator(".pickdrives label").first.click()
    page.wait_for_url("**pump-2.output_current**")
    page.locator(".trend-readout tbody tr .button").first.click()
    page.wait_for_url(lambda url: "fan-1" not in url)
    with page.expect_download() as saved:
        page.click("[data-export=save]")
    assert saved.value.suggested_filename.endswith(".csv")
    assert "pump-2.output_current [A]" in saved.value.path().read_text().splitlines()[0]  # one column a signal
    page.get_by_role("button", name=i18n.text("page.export_format_csv")).click()
    page.locator(".export").get_by_role("button", name="UTC", exact=True).click()
    with page.expect_download() as saved:
        page.click("[data-export=save]")
    assert saved.value.path().read_text().startswith("time,tag,")


def test_the_signals_of_ten_drives_are_listed_in_the_order_of_their_numbers(visit: Any) -> None:
    """Regression: fan-10 stood before fan-2, and the output frequency below signals that are used less."""
    drives = [f"fan-{n}" for n in range(1, 11)]
    signals = ("dc_bus_voltage", "output_frequency")
    tags = sorted((f"{drive}.{signal}", drive, signal) for drive in drives for signal in signals)
    known = [
        {"tag": tag, "drive": drive, "signal": signal, "unit": "", "text": {"en": signal, "zh": signal}}
        for tag, drive, signal in tags
    ]
    page = visit("#/fleet")
    page.route("**/api/v1/history/tags", lambda route: route.fulfill(json={"tags": known}))
    page.route("**/api/v1/history/trend?**", lambda route: fulfill_history(route, [0.0] * 600, [0] * 600))
    go_to(page, "history")
    page.click(".picker summary")
    boxes = page.locator(".pickdrives fieldset")
    expecting()(boxes).to_have_count(len(drives))
    first, last = boxes.first.inner_text(), boxes.last.inner_text()
    assert first.index("output frequency") < first.index("DC bus voltage")
    assert last.startswith("fan-10")


def test_a_value_of_a_lost_bus_is_not_shown_as_live(stage: Stage, visit: Any) -> None:
    page = visit("#/history?tags=pump-1.output_frequency")
    page.locator(".trend-readout td .value.good").wait_for()
    with unplugged(stage, "pumps"):
        page.locator(".trend-readout td .value:not(.good)").wait_for()


DRAWN_COUNTS = """async (places) => {
  const { drawEvents } = await import('/static/js/trend/draw-events.js');
  const drawn = [];
  const ctx = new Proxy(document.createElement('canvas').getContext('2d'), {
    set: (to, name, value) => Reflect.set(to, name, value),
    get: (to, name) => (name === 'fillText' ? (text, x) => {
      const width = to.measureText(text).width;
      drawn.push(to.textAlign === 'right' ? [x - width, x] : [x, x + width]);
    } : typeof to[name] === 'function' ? to[name].bind(to) : to[name]) });
  const plot = { ctx, bbox: { left: 0, top: 0, width: 1000, height: 200 }, valToPos: (x) => x };
  const markers = places.flatMap((t) => Array.from({ length: 15 }, () => ({ t, shape: 'alarm' })));
  drawEvents(plot, { markers, strips: [], states: [] }, { font: 'sans-serif', fault: 'red', mark: 'black' });
  return drawn;
}"""


def test_numbers_of_neighbouring_markers_do_not_overlap_at_the_right_edge(scripts: Any) -> None:
    """Regression: the number of the newest marker stands on its left, over that of the marker before it."""
    for distance in range(1, 60):
        drawn = sorted(scripts.evaluate(DRAWN_COUNTS, [990 - distance, 990]))
        assert all(left[1] < right[0] for left, right in pairwise(drawn)), distance
