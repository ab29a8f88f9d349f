"""The fleet page: its loading, its sparklines and its dense tiles."""

from __future__ import annotations

from typing import Any


def test_no_script_of_the_first_page_waits_for_the_imports_of_another(visit: Any) -> None:
    """Each script that the fleet needs is named in the page itself, and none that it does not need."""
    page = visit("#/fleet")
    page.locator(".tile").first.wait_for()
    named = set(page.eval_on_selector_all("link[rel=modulepreload]", "all => all.map((one) => one.href)"))
    loaded = page.evaluate("performance.getEntriesByType('resource').map((one) => one.name)")
    scripts = {url for url in loaded if url.endswith(".js")}
    assert len(scripts) > 30
    assert scripts == named
