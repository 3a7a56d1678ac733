"""What the server counts, in Prometheus's text format."""

from collections.abc import Callable

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

SECONDS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0)
"""Bounds of the histograms."""


class Measures:
    """Counters and histograms of a server."""

    def __init__(self, *, waiting: Callable[[], int], running: Callable[[], int]):
        """Takes functions that count requests in the queue, and those that are worked on."""
        registry = self._registry = CollectorRegistry()
        self.answers = Counter("t2m_answers", "Requests for motions by how they ended", ["result"], registry=registry)
        self.motions = Counter("t2m_motions", "Motions that were sent", registry=registry)
        self.restarts = Counter("t2m_worker_restarts", "Processes that died and were replaced", registry=registry)
        self.seconds = Histogram(
            "t2m_request_seconds", "From a request to its motions", buckets=SECONDS, registry=registry
        )
        self.work_seconds = Histogram("t2m_work_seconds", "Time without the queue", buckets=SECONDS, registry=registry)
        for name, count in (("waiting", waiting), ("running", running)):
            Gauge(f"t2m_{name}_requests", f"Requests that are {name}", registry=registry).set_function(count)

    def text(self) -> bytes:
        """Returns all values."""
        return generate_latest(self._registry)
