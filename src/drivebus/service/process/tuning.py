"""Who gets the processor first: the buses, then the people, then what can wait."""

from __future__ import annotations

import gc
import os
from contextlib import suppress

NICE_WEB, NICE_BATCH = 5, 10
"""Steps of ``nice`` behind the plant's process: a third and a tenth of what it gets where the processor is short."""


def set_nice(steps: int) -> None:
    """This process runs when the plant's does not want to. Nothing where the system knows no such thing (Windows)."""
    with suppress(AttributeError, OSError):
        os.nice(steps)


def relax_gc() -> None:
    """What there is now is not looked through for garbage again, and the rest a hundredth as often.

    A full collection stands still for up to 0.1 s (60 ms for 64 drives), and came every 2 s; what a plant throws away
    is found by the short ones, or has no circles.
    """
    gc.collect()
    gc.freeze()
    young, middle, old = gc.get_threshold()
    gc.set_threshold(young, middle, 100 * old)
