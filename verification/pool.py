"""Pieces of a campaign done by two processes: the results come in the order of the tasks, whoever did them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import get_context
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


def map_in_order(function: Callable[[Task], Result], tasks: Iterable[Task], *, in_process: bool) -> Iterator[Result]:
    """``alone``: so little that this process does it by itself."""
    if in_process:
        yield from map(function, tasks)
        return
    with get_context("spawn").Pool(min(2, os.cpu_count() or 1)) as pool:
        yield from pool.imap(function, tasks)
