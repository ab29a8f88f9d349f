"""Points as the text that Prometheus reads; the one door of its library."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector, CollectorRegistry

from drivebus.web.metrics_points import Point
from drivebus.web.metrics_table import METRICS, Metric


class _PointCollector(Collector):
    """The points of one scrape; nothing is kept for the next."""

    def __init__(self, points: Iterable[Point]) -> None:
        self._points = points

    def collect(self) -> Iterator[Family]:
        families = {name: _metric_family(metric) for name, metric in METRICS.items()}
        for point in self._points:
            families[point.metric].add_metric(point.labels, point.value)
        yield from families.values()


def _metric_family(metric: Metric) -> CounterMetricFamily | GaugeMetricFamily:
    kind = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
    return kind(metric.full_name, metric.text("en"), labels=metric.labels)


def exposition(points: Iterable[Point], accept: str) -> tuple[bytes, str]:
    """The text and its media type: OpenMetrics where ``accept`` asks for it, else the classic form."""
    registry = CollectorRegistry()
    registry.register(_PointCollector(points))
    encoder, media_type = choose_encoder(accept)
    return encoder(registry), media_type
