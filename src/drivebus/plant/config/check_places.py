"""Files, folders, addresses of the network: what the service will need at its start."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from urllib.parse import urlsplit

from drivebus.plant.config.build import state_directory
from drivebus.plant.config.draft import Draft
from drivebus.plant.loopback import is_loopback
from drivebus.profiles.complaint import Problem, problem

_ORIGIN = re.compile(r"https?://[A-Za-z0-9._\-\[\]:]+")


def problems(draft: Draft) -> Iterator[Problem]:
    yield from _directory(draft)
    yield from _users(draft)
    yield from _audit(draft)
    yield from _web(draft)
    yield from _history(draft)


def _directory(draft: Draft) -> Iterator[Problem]:
    plant = draft.file.plant
    where = draft.path(plant.directory) if plant.directory else state_directory(plant.id)
    if where.exists() and not where.is_dir():
        yield problem("not_a_folder", ("plant", "directory"), str(where))


def _users(draft: Draft) -> Iterator[Problem]:
    if draft.file.plant.users is None:
        return
    where = draft.path(draft.file.plant.users)
    if where.is_dir() or not where.parent.is_dir():
        yield problem("users_file", ("plant", "users"), str(where))


def _audit(draft: Draft) -> Iterator[Problem]:
    for name in ("checkpoints", "key"):
        text = getattr(draft.file.audit, name)
        where = None if text is None else draft.path(text)
        if where is not None and (where.is_dir() or not where.parent.is_dir()):
            yield problem("audit_file", ("audit", name), str(where))


def _web(draft: Draft) -> Iterator[Problem]:
    web = draft.file.web
    for name, other in (("certificate", "key"), ("key", "certificate")):
        text = getattr(web, name)
        if text is None:
            continue
        if not draft.path(text).is_file():
            yield problem("web_file", ("web", name), str(draft.path(text)))
        if getattr(web, other) is None:
            yield problem("needs_other", ("web", name), text, other=other)
    if web.enabled and web.certificate is None and not is_loopback(web.host):
        yield problem("tls", ("web", "host"), web.host)
    for origin in web.origins:
        if not _ORIGIN.fullmatch(origin):
            yield problem("origin", ("web", "origins"), origin)


def _history(draft: Draft) -> Iterator[Problem]:
    history = draft.file.history
    if history.url is not None and not _is_postgres(history.url):
        yield problem("history_url", ("history", "url"), hidden(history.url))
    steps = ("raw_days", "second_days", "minute_days", "hour_days")
    for shorter, longer in pairwise(steps):
        least, found = getattr(history, shorter), getattr(history, longer)
        if found < least:
            also = (("history", shorter),)
            yield problem("retention", ("history", longer), found, shorter=shorter, least=f"{least:g}", also=also)


def _is_postgres(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return parts.scheme in ("postgresql", "postgres") and bool(parts.path.strip("/")) and parts.port != 0
    except ValueError:
        return False


def hidden(url: str) -> str:
    """The URL without its password: complaints are shown, logged and sent."""
    return re.sub(r"(//[^:/@]*):[^@]*@", r"\1:…@", url)
