"""Reference of the metrics: name, kind, labels and meaning of each, from their declarations."""

from __future__ import annotations

from collections.abc import Sequence

from drivebus.values import Text
from drivebus.web.metrics import BUS_METRICS, DRIVE_METRICS, PLANT_METRICS, Metric
from generator.terms import localized, table, term

HEADS = {"kind": Text("kind", "类型"), "labels": Text("labels", "标签")}
KINDS = {"counter": Text("counter", "计数"), "gauge": Text("gauge", "瞬时值")}


def parts(language: str) -> dict[str, str]:
    """Return the generated parts of ``docs/reference/metrics.md``."""
    return {
        name: _table(some, language)
        for name, some in (("plant", PLANT_METRICS), ("buses", BUS_METRICS), ("drives", DRIVE_METRICS))
    }


def _table(metrics: Sequence[Metric], language: str) -> str:
    heads = [term("name", language), localized(HEADS["kind"], language), localized(HEADS["labels"], language)]
    rows = [
        (
            f"`{metric.full_name}`",
            localized(KINDS[metric.kind], language),
            " ".join(f"`{label}`" for label in metric.labels),
            metric.text(language),
        )
        for metric in metrics
    ]
    return table([*heads, term("meaning", language)], rows)
