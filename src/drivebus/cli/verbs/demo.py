"""``demo``: a virtual plant of all four families, live."""

from __future__ import annotations

from drivebus.cli.command import Option, Verb
from drivebus.cli.exits import Exit


def _demo(plain: bool, memory: bool, period: float) -> Exit:
    from drivebus.cli.demo.plant import MemoryPlant, make_plant
    from drivebus.cli.demo.stage import Stage
    from drivebus.cli.live.start import show

    stage = Stage(MemoryPlant() if memory else make_plant())
    return show(stage, stage, plain, period)


command = Verb(
    "demo",
    callback=_demo,
    params=[
        Option(["--plain"], is_flag=True),
        Option(["--memory"], is_flag=True),
        Option(["--period"], type=float, default=5.0, metavar="S", example="--period 2"),
    ],
    examples=("drivebus demo", "drivebus demo --lang zh", "drivebus demo --plain --period 2", "drivebus demo --json"),
)
