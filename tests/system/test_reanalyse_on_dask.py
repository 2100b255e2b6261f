"""Workers on Dask: a chunk that kills them is divided."""

from __future__ import annotations

import os
import signal

import pytest

from sunarc.detection import Detection
from sunarc.findings import Finding
from sunarc.offline.reanalysis.cluster import Workers, open_cluster
from sunarc.offline.reanalysis.look import Answer, Chunk, Item
from sunarc.runtime.clock import SystemClock

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]


def deadly(chunk: Chunk) -> list[Answer]:
    """Answer for images, and die of one of them."""
    if any(item.file == "deadly" for item in chunk.items):
        os.kill(os.getpid(), signal.SIGKILL)
    sun = Detection(method="paper", accepted=False, verdict="hidden", findings=())
    return [Answer(item.file, item.number, sun) for item in chunk.items]


@pytest.mark.filterwarnings("ignore")
def test_a_chunk_that_kills_its_workers_is_divided_until_the_one_image_is_set_apart() -> None:
    chunks = [
        Chunk("roof", "", "auto", (9, 9), tuple(Item(name, 0, None) for name in names))
        for names in (("a", "b"), ("c", "deadly"), ("d",))
    ]
    found: dict[str, str] = {}

    def done(_: Chunk, answers: list[Answer]) -> None:
        assert not {one.file for one in answers} & set(found)
        found.update({one.file: one.found.code if isinstance(one.found, Finding) else "" for one in answers})

    with open_cluster(Workers(None, 1, deaths=1), clock=SystemClock()) as cluster:
        assert cluster.dashboard.startswith("http://127.0.0.1:")
        cluster.look(chunks, done, run=deadly)
        assert cluster.each(len, [(), (1, 2)]) == [0, 2]  # the workers go on
    assert found == {"a": "", "b": "", "c": "", "d": "", "deadly": "image_kills_workers"}
