"""Draws docs/images/demo.svg and demo.zh.svg: the demo's own screen, taken in the middle of a real run on real ptys.

python docs/screenshot.py
"""

from __future__ import annotations

import asyncio
import re
import sys
from pathlib import Path

from drivebus.cli import voice
from drivebus.cli.demo.plant import make_plant
from drivebus.cli.demo.stage import Stage
from drivebus.cli.live.screen import Screen
from drivebus.cli.live.thread import Threaded

IMAGES = Path(__file__).parent / "images"
AT_S = 16.0
"""Second of the story: several drives run, one has tripped."""
SIZE = (110, 32)


async def draw(language: str) -> str:
    """One picture, as SVG."""
    voice.listen(["--lang", language])
    stage = Stage(make_plant())
    feed = Threaded(stage, stage)
    screen = Screen(feed, feed)
    async with screen.run_test(size=SIZE) as pilot:
        await asyncio.sleep(AT_S)
        await pilot.pause()
        return _self_contained(screen.export_screenshot(title="drivebus demo"))


def _self_contained(svg: str) -> str:
    """No fonts from elsewhere: a picture must not fetch anything when a page shows it."""
    svg = re.sub(r"@font-face \{.*?\}\n?", "", svg, flags=re.DOTALL)
    return svg.replace("Fira Code, monospace", "ui-monospace, Menlo, Consolas, 'Noto Sans Mono CJK SC', monospace")


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    for language, name in (("en", "demo.svg"), ("zh", "demo.zh.svg")):
        (IMAGES / name).write_text(asyncio.run(draw(language)), encoding="utf-8")
        sys.stdout.write(f"{IMAGES / name}\n")


if __name__ == "__main__":
    main()
