"""One line a happening on standard error: text for people, JSON for machines; no text can forge a line (S13)."""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import queue
import sys
from logging.handlers import QueueHandler, QueueListener
from typing import Any, TextIO

from drivebus import i18n
from drivebus.seams import wall_clock

Json = dict[str, Any]
LOG = logging.getLogger("drivebus.plant")
WAITING = 10_000
"""So many lines wait for a log that hangs; what comes then is dropped (I12)."""
LAST_S = 1.0
LEVELS = {"fault": logging.ERROR, "alarm": logging.WARNING, "presence": logging.WARNING}


def begin(form: str, stream: TextIO | None = None) -> None:
    """From now on the plant's log goes to ``stream`` as ``text`` or ``json``."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else PlainLines())
    lines: queue.Queue[logging.LogRecord] = queue.Queue(WAITING)
    listener = QueueListener(lines, handler)
    root = logging.getLogger("drivebus")
    root.handlers = [Waiting(lines)]
    root.setLevel(logging.INFO)
    root.propagate = False
    listener.start()
    atexit.register(_end, lines, listener)


def _end(lines: queue.Queue[Any], listener: QueueListener) -> None:
    """Write what waits; a log that still hangs then is left, its thread ends with the process."""
    thread = listener._thread
    with contextlib.suppress(queue.Full):
        lines.put(listener._sentinel, timeout=LAST_S)  # type: ignore[attr-defined]
    if thread is not None:
        thread.join(LAST_S)


class Waiting(QueueHandler):
    """Hands a line to the thread that writes: whoever reads the log and hangs holds up no bus, and loses lines."""

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        return record

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def happened(event: Json) -> None:
    """An event of the plant as a line of the log."""
    LOG.log(LEVELS.get(event["kind"], logging.INFO), event["text"][i18n.preferred()], extra={"event": event})


class JsonLines(logging.Formatter):
    """One object a line."""

    def format(self, record: logging.LogRecord) -> str:
        event = getattr(record, "event", None) or {}
        found = {
            "time": wall_clock().isoformat(timespec="milliseconds"), "level": record.levelname.lower(),
            "text": record.getMessage(), **{name: event[name] for name in NAMED if event.get(name) is not None},
        }  # fmt: skip
        if record.exc_info:
            found["trace"] = self.formatException(record.exc_info)
        return json.dumps(found, ensure_ascii=False)


NAMED = ("kind", "drive", "actor", "outcome")


class PlainLines(logging.Formatter):
    """``2026-11-21T22:00:00+00:00 WARNING fan-1: fan-1 does not answer any more``."""

    def format(self, record: logging.LogRecord) -> str:
        event = getattr(record, "event", None) or {}
        drive = f"{event['drive']}: " if event.get("drive") else ""
        line = f"{wall_clock().isoformat(timespec='seconds')} {record.levelname} {drive}{record.getMessage()}"
        shown = "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in line)
        return f"{shown}\n{self.formatException(record.exc_info)}" if record.exc_info else shown
