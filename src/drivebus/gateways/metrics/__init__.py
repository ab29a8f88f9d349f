"""``/metrics`` for Prometheus: the plant's state in numbers, asked anew for each scrape."""
