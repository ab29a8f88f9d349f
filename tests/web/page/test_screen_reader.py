"""Announcements of a screen reader without an action of the user."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import expecting, hold_topics, trip

COUNTED = """async () => {
  const region = document.querySelector("[data-text=alarm]");
  window.announced = [];
  new MutationObserver(() => { if (region.textContent) window.announced.push(region.textContent); })
    .observe(region, { childList: true, characterData: true, subtree: true });
}"""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_new_urgent_alarm_is_announced_once_on_every_page(stage: Stage, visit: Any, language: str) -> None:
    """It stood in the strip, which no screen reader announces; the sound does not name the drive."""
    page = visit("#/settings", language=language)
    page.locator("main h1").wait_for()
    page.evaluate(COUNTED)
    trip(stage, "fan-3")
    name = {"en": "Flue gas fan", "zh": "引风机"}[language]
    fault = i18n.text("alarms.title.fault", language)
    page.wait_for_function("(fault) => window.announced.some((text) => text.includes(fault))", arg=fault)
    page.wait_for_timeout(1500)
    # Where a busy machine loses or damages a reply, that is announced too.
    [text] = [announced for announced in page.evaluate("window.announced") if fault in announced]
    assert name in text and i18n.text("page.priority_critical", language) in text
    assert page.locator("[data-text=alarm]").get_attribute("role") == "alert"
    if language == "en":  # once: it takes ten seconds
        expecting()(page.locator("[data-text=alarm]")).to_have_text("")  # not longer than it may be true


STORM = """async () => {
  const { applyDelta } = await import('/static/js/store.js');
  const active = [];
  for (let n = 0; n < 20; n += 1) {
    const title = { en: `T${n}`, zh: `T${n}` };
    active.push({ id: `x${n}`, kind: 'fault', drive: 'fan-1', priority: 'critical', title, text: title,
      cleared_ms: null, acknowledged_ms: null, shelved_until_ms: null, raised_ms: n });
    applyDelta({ topics: { alarms: { active: [...active] } } });
    await new Promise((resolve) => { setTimeout(resolve, 50); });
  }
}"""
"""Script: 20 alarms within a second."""


def test_alarms_that_follow_each_other_closely_are_announced_together(visit: Any) -> None:
    """Regression: in a storm each text interrupted the one before, and none was read out."""
    page = visit("#/settings")
    page.locator("main h1").wait_for()
    page.evaluate(COUNTED)
    hold_topics(page)
    page.evaluate(STORM)
    assert page.evaluate("window.announced.length") < 5
    page.wait_for_function("() => window.announced.length > 1 && window.announced.at(-1).includes('T19')")


SILENT = """(left_ms) => import("/static/js/drive/comm-loss-test.js").then(async ({ CommLossTest }) => {
  const [{ html, render }, { serviceNow }] = await Promise.all(
    ["lib", "store"].map((one) => import(`/static/js/${one}.js`)));
  const view = { id: "fan-1", comm_loss: { test: { phase: "silent", until_ms: serviceNow() + left_ms } } };
  const main = document.querySelector("main");
  render(html`<${CommLossTest} view=${view} />`, main);
  window.changes = [];
  new MutationObserver((records) => { for (const { target } of records) {
    const region = (target.nodeType === Node.TEXT_NODE ? target.parentElement : target)
      .closest("[aria-live], [role=alert], [role=status], [role=log], [role=timer]");
    window.changes.push(region?.getAttribute("aria-live") ?? region?.getAttribute("role") ?? "none");
  } }).observe(main, { childList: true, characterData: true, subtree: true });
})"""
"""Shows a silence of a test, and records the live region of each later change of its text."""


def test_the_seconds_of_a_communication_loss_test_are_not_announced(visit: Any) -> None:
    """Each second the whole notice was read again: the nearest live region of the seconds must be a silent one."""
    page = visit("#/settings")
    page.locator("main h1").wait_for()
    page.evaluate(SILENT, 8400)
    page.locator("main [role=alert]").wait_for()
    page.wait_for_function("() => window.changes.length > 0")
    assert set(page.evaluate("window.changes")) <= {"timer", "off"}
