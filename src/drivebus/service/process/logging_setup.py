"""Log of the service: one line per event on standard error, as text or JSON. No text can forge a line."""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import queue
import re
import sys
from collections.abc import Callable, Collection
from logging.handlers import QueueHandler, QueueListener
from math import inf
from time import monotonic
from typing import Any, Literal, TextIO

from drivebus import i18n
from drivebus.clock import wall_clock
from drivebus.types import Json

LOG = logging.getLogger("drivebus.service")
MAX_QUEUED_RECORDS = 10_000  # further lines are dropped while the log hangs
FLUSH_TIMEOUT_S = 1.0  # the end of the process never waits longer for a log that hangs
REPETITION_INTERVAL_S = 10.0  # least time between messages of a library that begin alike
REPETITION_PREFIX_CHARS = 60  # messages that share their first characters are alike
MAX_MESSAGE_KINDS = 100  # kinds that the filter counts; a further one resets it
_INTERVAL_ATTRIBUTE = "repetition_interval_s"
AT_LONG_INTERVALS = {_INTERVAL_ATTRIBUTE: 600.0}
"""``extra`` of a record about something that another program may cause again and again."""
LogFormat = Literal["text", "json"]
EVENT_LEVELS = {
    "fault": logging.ERROR,
    "alarm": logging.WARNING,
    "presence": logging.WARNING,
    "gateway": logging.WARNING,
    "not_stopped": logging.WARNING,
}


def configure_logging(
    log_format: LogFormat, stream: TextIO | None = None, *, without_events: Collection[str] = ()
) -> None:
    """Write the log to ``stream`` as ``text`` or ``json``: everything of drivebus, and the warnings of libraries.

    ``without_events``: kinds of events that are left out. The texts are read now, because a process that has run out of
    file descriptors later could not read them.
    """
    for language in i18n.LANGUAGES:
        i18n.catalogue(language)
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(JsonFormatter() if log_format == "json" else PlainFormatter())
    lines: queue.Queue[logging.LogRecord] = queue.Queue(MAX_QUEUED_RECORDS)
    listener = QueueListener(lines, handler)
    queued = NonBlockingQueueHandler(lines)
    queued.addFilter(RepetitionFilter())
    queued.addFilter(lambda record: getattr(record, "event", {}).get("kind") not in without_events)
    for name, level in (("drivebus", logging.INFO), ("", logging.WARNING)):
        logger = logging.getLogger(name)
        logger.handlers = [queued]
        logger.setLevel(level)
        logger.propagate = False
    listener.start()
    atexit.register(_flush, lines, listener)


def _flush(lines: queue.Queue[Any], listener: QueueListener) -> None:
    """Write the queued lines, unless the log still hangs after the timeout."""
    thread = listener._thread
    with contextlib.suppress(queue.Full):
        lines.put(listener._sentinel, timeout=FLUSH_TIMEOUT_S)  # type: ignore[attr-defined]
    if thread is not None:
        thread.join(FLUSH_TIMEOUT_S)


class RepetitionFilter(logging.Filter):
    """Filter of what libraries log about every connection: clients could fill the disk with it.

    Of messages that begin alike one passes in ``REPETITION_INTERVAL_S``, with the number of those left out before it.
    Records of drivebus itself all pass, but those with ``AT_LONG_INTERVALS``: one with this text in that time.
    """

    def __init__(self, now: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._now = now
        self._passed: dict[tuple[str, str], tuple[float, int]] = {}
        """Time of the last message of a kind that passed, and number of those left out since."""

    def filter(self, record: logging.LogRecord) -> bool:
        text, interval_s = record.getMessage(), getattr(record, _INTERVAL_ATTRIBUTE, None)
        kind = record.name, text
        if interval_s is None:
            if record.name.split(".")[0] == "drivebus":
                return True
            interval_s = REPETITION_INTERVAL_S
            kind = record.name, text.partition("\n")[0][:REPETITION_PREFIX_CHARS]
        now, (passed_at, left_out) = self._now(), self._passed.get(kind, (-inf, 0))
        if now - passed_at < interval_s:
            self._passed[kind] = passed_at, left_out + 1
            return False
        if len(self._passed) >= MAX_MESSAGE_KINDS:
            self._passed.clear()
        self._passed[kind] = now, 0
        if left_out:
            record.msg, record.args = i18n.preferred_text("log.repeated", text=text, n=left_out), None
        return True


class NonBlockingQueueHandler(QueueHandler):
    """Handler that never waits: where the reader of the log hangs, lines are dropped."""

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        return record

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def log_event(event: Json) -> None:
    """Log an event in the language of this process, at the level of its kind."""
    LOG.log(EVENT_LEVELS.get(event["kind"], logging.INFO), event["text"][i18n.preferred()], extra={"event": event})


class JsonFormatter(logging.Formatter):
    """Formatter of one JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        event = getattr(record, "event", None) or {}
        document = {
            "time": wall_clock().isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "text": record.getMessage(),
            **{name: event[name] for name in EVENT_FIELDS if event.get(name) is not None},
        }
        if record.exc_info:
            document["trace"] = self.formatException(record.exc_info)
        return json.dumps(document, ensure_ascii=False)


EVENT_FIELDS = ("kind", "drive", "actor", "outcome")


class PlainFormatter(logging.Formatter):
    """Formatter of lines such as ``2026-11-21T22:00:00+00:00 INFO fan-1: stop confirmed``.

    A sentence that begins with the name of the drive gets no prefix.
    """

    def format(self, record: logging.LogRecord) -> str:
        event = getattr(record, "event", None) or {}
        name, text = event.get("drive"), record.getMessage()
        prefix = f"{name}: " if name and not re.match(rf"{re.escape(name)}(?![A-Za-z0-9_-])", text) else ""
        line = f"{wall_clock().isoformat(timespec='seconds')} {record.levelname} {prefix}{text}"
        shown = "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in line)
        return f"{shown}\n{self.formatException(record.exc_info)}" if record.exc_info else shown
