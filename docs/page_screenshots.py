"""Draw docs/images/*.png: pages of the demo in Chromium, taken after its script has tripped a fan.

python docs/page_screenshots.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

IMAGES = Path(__file__).parent / "images"
PORT = 8097
BROWSER = "/usr/bin/chromium-headless-shell"  # of Debian, as the tests of the page use
HISTORY_TAGS = ",".join(f"{drive}.output_frequency" for drive in ("conveyor-1", "conveyor-2", "fan-1", "fan-2"))
TRIP_S = 28.0  # after the first output of the demo
HISTORY_LOAD_S = 3.0  # until the trend is drawn


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Image: page, language, colour scheme and size."""

    name: str
    page: str
    width: int
    height: int
    language: str = "en"
    scheme: str = "light"


PICTURES = (  # in the order of the demo: its adapter is pulled soon after the trip
    Picture(name="drive.zh.png", page="drive/spindle-1", width=1440, height=1000, language="zh", scheme="dark"),
    Picture(name="fleet.png", page="fleet", width=1440, height=900),
    Picture(name="phone.zh.png", page="fleet", width=360, height=740, language="zh"),
    Picture(name="history.png", page=f"history?tags={HISTORY_TAGS}", width=1440, height=900, scheme="dark"),
)


def main() -> None:
    command = [sys.executable, "-m", "drivebus", "demo", "--port", str(PORT), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demo:
        try:
            assert demo.stdout is not None
            address = json.loads(demo.stdout.readline())["url"]
            time.sleep(TRIP_S)
            _draw(address)
        finally:
            demo.terminate()


def _draw(address: str) -> None:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"])
        first = browser.new_context()
        page = first.new_page()
        page.goto(address)
        page.wait_for_selector(".connection.live")  # the login page has a main element too
        state = first.storage_state()
        for picture in PICTURES:
            _take(browser, state, picture)
        browser.close()


def _take(browser: Any, state: Any, picture: Picture) -> None:
    context = browser.new_context(
        storage_state=state,
        viewport={"width": picture.width, "height": picture.height},
        locale={"en": "en-GB", "zh": "zh-CN"}[picture.language],
        color_scheme=picture.scheme,
    )
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{PORT}/#/{picture.page}")
    page.wait_for_timeout(1000 * HISTORY_LOAD_S)
    page.screenshot(path=IMAGES / picture.name)
    context.close()


if __name__ == "__main__":
    main()
