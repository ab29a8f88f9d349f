"""Checks of a well-formed ``plant.toml``: all of them together, and those of texts, paths and history."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from urllib.parse import urlsplit

from drivebus.profiles.diagnostics import Diagnostic, Issue, control_character_issues, issue
from drivebus.service.config import check_buses, check_rules
from drivebus.service.config.build import ParsedPlant, state_directory
from drivebus.service.config.gateways import gateway_issues
from drivebus.service.config.redaction import HIDDEN, redact_url

MULTILINE_KEYS = ("require",)  # an expression may be written on several lines


def all_issues(parsed: ParsedPlant) -> Iterator[Issue | Diagnostic]:
    """Yield every issue of a plant file. Fills in the profiles, port URLs and dialects of ``parsed``."""
    parsed.read_profiles()
    yield from control_character_issues(parsed.raw, multiline=MULTILINE_KEYS)
    yield from path_issues(parsed)
    yield from gateway_issues(parsed.file.gateway, parsed.named_path)
    yield from check_buses.bus_issues(parsed)
    yield from check_buses.drive_issues(parsed)
    yield from check_buses.bus_load_issues(parsed)
    yield from check_rules.rule_issues(parsed)


def path_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    yield from _check_directory(parsed)
    yield from _check_users(parsed)
    yield from _check_audit(parsed)
    yield from _check_history(parsed)


def _check_directory(parsed: ParsedPlant) -> Iterator[Issue]:
    plant = parsed.file.plant
    where = parsed.resolve_path(plant.directory) if plant.directory else state_directory(plant.id)
    if where.exists() and not where.is_dir():
        yield issue("not_a_folder", ("plant", "directory"), str(where))


def _check_users(parsed: ParsedPlant) -> Iterator[Issue]:
    if parsed.file.plant.users is None:
        return
    where = parsed.resolve_path(parsed.file.plant.users)
    if where.is_dir() or not where.parent.is_dir():
        yield issue("users_file", ("plant", "users"), str(where))


def _check_audit(parsed: ParsedPlant) -> Iterator[Issue]:
    for name in ("checkpoints", "key", "head"):
        text = getattr(parsed.file.audit, name)
        where = None if text is None else parsed.resolve_path(text)
        if where is not None and (where.is_dir() or not where.parent.is_dir()):
            yield issue("audit_file", ("audit", name), str(where))


def _check_history(parsed: ParsedPlant) -> Iterator[Issue]:
    history = parsed.file.history
    if history.url is not None and (HIDDEN in history.url or not _is_postgres(history.url)):
        yield issue("history_url", ("history", "url"), redact_url(history.url))
    retention = history.retention.model_dump()
    for shorter, longer in pairwise(retention):
        minimum_days, days = retention[shorter], retention[longer]
        if days < minimum_days:
            path, also = ("history", "retention", longer), (("history", "retention", shorter),)
            yield issue("retention", path, days, shorter=shorter, least=f"{minimum_days:g}", related=also)


def _is_postgres(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return parts.scheme in ("postgresql", "postgres") and bool(parts.path.strip("/")) and parts.port != 0
    except ValueError:
        return False
