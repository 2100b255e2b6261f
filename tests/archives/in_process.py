"""What a cluster does, in the test's own process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from sunarc.archives.cluster import Workers
from sunarc.sources.look import Answer, Chunk, Done, look_at


class InProcess:
    """Chunks are looked at one after the other; counts them and what else is called, and ends the run after some."""

    dashboard = ""

    def __init__(self, *, most: int | None = None) -> None:
        self.workers = Workers()
        self.chunks: list[Chunk] = []
        self.calls: list[str] = []
        self._most = most

    def each(self, run: Callable[[Any], Any], given: Sequence[Any]) -> list[Any]:
        self.calls += [run.__name__] * len(given)
        return [run(one) for one in given]

    def look(self, chunks: Sequence[Chunk], done: Done, *, run: Callable[[Chunk], list[Answer]] = look_at) -> None:
        for chunk in chunks:
            if self._most is not None and len(self.chunks) >= self._most:
                raise KeyboardInterrupt
            self.chunks.append(chunk)
            done(chunk, run(chunk))


def use(cluster: InProcess, patch: pytest.MonkeyPatch) -> None:
    """Have runs use a cluster."""

    @contextmanager
    def opened(*_: object, **__: object) -> Iterator[InProcess]:
        yield cluster

    patch.setattr("sunarc.archives.run.open_cluster", opened)
