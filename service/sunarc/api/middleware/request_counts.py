"""Counts of HTTP requests, for Prometheus."""

from __future__ import annotations

import asyncio
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from itertools import accumulate

from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_BOUNDS_S = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0)
"""From an answer out of memory to the largest map."""


class RequestCounts(Collector):
    """How many requests were answered, with which status, and how fast; written on the event loop alone."""

    def __init__(self) -> None:
        self._by_status: Counter[str] = Counter()
        self._by_duration = [0] * (len(_BOUNDS_S) + 1)
        self._sum_s = 0.0

    def add(self, status: int, duration_s: float) -> None:
        """Count an answer."""
        self._by_status[str(status)] += 1
        self._by_duration[bisect_left(_BOUNDS_S, duration_s)] += 1
        self._sum_s += duration_s

    def collect(self) -> Iterator[Metric]:
        """Yield the numbers."""
        requests = CounterMetricFamily("sunarc_http_requests", "Requests that were answered.", labels=("status",))
        for status, n in sorted(self._by_status.copy().items()):
            requests.add_metric((status,), float(n))
        yield requests
        text = "From the request to the status of the answer, s."
        buckets = [str(bound) for bound in _BOUNDS_S] + ["+Inf"]
        counts = map(float, accumulate(self._by_duration.copy()))
        yield HistogramMetricFamily(
            "sunarc_http_request_seconds", text, buckets=list(zip(buckets, counts, strict=True)), sum_value=self._sum_s
        )


class CountRequests:
    """Counts every request and how long it took until the status of the answer was known.

    Parameters
    ----------
    app : what is behind it.
    counts : where they are counted.
    """

    def __init__(self, app: ASGIApp, *, counts: RequestCounts) -> None:
        self._app, self._counts = app, counts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        clock = asyncio.get_running_loop()
        begun_s = clock.time()

        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._counts.add(message["status"], clock.time() - begun_s)
            await send(message)

        await self._app(scope, receive, counted)
