"""Draw docs/images/demo.svg and demo.zh.svg: the screen of ``drivebus demo --terminal`` when one drive has tripped.

python docs/screenshot.py
"""

from __future__ import annotations

import asyncio
import html
import itertools
import re
import sys
from pathlib import Path

from rich.cells import cell_len

from drivebus.cli import output
from drivebus.cli.demo.terminal import DemoClient
from drivebus.cli.tui.app import MonitorApp
from drivebus.cli.tui.threaded import ThreadedRowSource

IMAGES = Path(__file__).parent / "images"
TRIP_TIMEOUT_S = 60.0  # the script trips a drive after 20 s
SIZE = (110, 32)  # columns and rows of the terminal
CELL = 12.2  # width of a terminal cell in the exported picture


async def draw(language: str) -> str:
    """Run the demo until a drive has tripped; return the screen as SVG."""
    output.parse_global_options(["--lang", language])
    client = DemoClient()
    source = ThreadedRowSource(client, client)
    screen = MonitorApp(source, source)
    async with screen.run_test(size=SIZE) as pilot:
        async with asyncio.timeout(TRIP_TIMEOUT_S):
            while not any(row.state == "fault" for row in source.drives()):  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        await pilot.pause(0.5)
        return _in_cells(_self_contained(screen.export_screenshot(title="drivebus demo")))


def _in_cells(svg: str) -> str:
    """Place every character at its cell: fonts differ in width, and a Chinese character has two cells."""

    def placed(found: re.Match[str]) -> str:
        left, between, characters = float(found[1]), found[2], html.unescape(found[3])
        columns = itertools.accumulate(map(cell_len, characters[:-1]), initial=0)
        places = " ".join(f"{left + column * CELL:.1f}" for column in columns)
        return f'<text x="{places}"{between}>{html.escape(characters, quote=False)}</text>'

    svg = re.sub(
        r'<text class="([^"]*)" x="([\d.]+)" y="([\d.]+)" textLength="[\d.]+"', r'<text x="\2" y="\3" class="\1"', svg
    )
    return re.sub(r'<text x="([\d.]+)"([^>]*)>([^<]+)</text>', placed, svg)


def _self_contained(svg: str) -> str:
    """Replace the web fonts: a picture must not fetch anything when a page shows it."""
    svg = re.sub(r"@font-face \{.*?\}\n?", "", svg, flags=re.DOTALL)
    return svg.replace(
        "Fira Code, monospace", "Menlo, Consolas, 'DejaVu Sans Mono', 'Noto Sans Mono CJK SC', monospace"
    )


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    for language, name in (("en", "demo.svg"), ("zh", "demo.zh.svg")):
        (IMAGES / name).write_text(asyncio.run(draw(language)), encoding="utf-8")
        sys.stdout.write(f"{IMAGES / name}\n")


if __name__ == "__main__":
    main()
