"""Processor priorities, memory and garbage collection: the buses come first, then the gateways, then batch work."""

from __future__ import annotations

import gc
import os
from contextlib import suppress

NICE_GATEWAY = 5  # steps of nice behind the service: a third of its share of a busy processor
NICE_BATCH = 10  # steps of nice behind the service: a tenth of its share


def set_nice(steps: int) -> None:
    """Lower the priority of this process; without effect on Windows."""
    with suppress(AttributeError, OSError):
        os.nice(steps)


def limit_memory(max_bytes: int) -> None:
    """Limit the address space of this process to ``max_bytes``; without effect on Windows."""
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))


def raise_file_limit() -> None:
    """Raise the number of files that this process may open to the most that the system grants it.

    Without effect on Windows. The usual limit of 1,024 is less than a service with many connections may need.
    """
    with suppress(ImportError, OSError, ValueError):
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def relax_gc() -> None:
    """Exclude the present objects from garbage collection, and make full collections a hundred times rarer.

    A full collection stops the loop for up to 0.1 s (60 ms for 64 drives), and came every 2 s; short collections and
    reference counts free what a service discards.
    """
    gc.collect()
    gc.freeze()
    young, middle, old = gc.get_threshold()
    gc.set_threshold(young, middle, 100 * old)
