"""Composites over HTTP: listed by page, whole, in parts, small, and what cannot be given."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Pictures

from sunarc.imager.archive.images import ImageStore
from sunarc.imaging.metadata import embedded_document, jpeg_with, png_with

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

FIRST = datetime(2013, 5, 13, 17, 0, 0, 250_000, tzinfo=UTC)
TIMES = [FIRST + timedelta(hours=4 * k) for k in range(4)]
SHAPE = (60, 80)


def composite(k: int) -> NDArray[np.uint16]:
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    return np.asarray(1000 * k + 300 * x + 40 * y, dtype=np.uint16)


@pytest.fixture
def store(tmp_path: Path) -> ImageStore:
    kept = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    for k, time in enumerate(TIMES):
        document = {
            "schema": "sunarc.image/1",
            "time_utc": f"{time:%Y-%m-%dT%H:%M:%S.%fZ}",
            "exposures": [{"exposure_us": 3000.0}, {"exposure_us": 12_000.0}, {"exposure_us": 48_000.0}],
        }
        png = cv2.imencode(".png", composite(k))[1].tobytes()
        jpeg = cv2.imencode(".jpg", (composite(k) >> 8).astype(np.uint8))[1].tobytes()
        kept.write(time, png_with(png, document, software="sunarc", created=str(document["time_utc"])), kind="hdr.png")
        kept.write(time, jpeg_with(jpeg, document), kind="hdr.jpg")
    (kept.folder / "2013" / "05" / "13" / "notes_hdr.png").write_bytes(b"not ours")
    return kept


@pytest.fixture
def served(make: Make, store: ImageStore) -> Made:
    return make(history="filled", images=store)


def name(time: datetime) -> str:
    return f"{time:%Y-%m-%dT%H:%M:%S}.{time.microsecond // 1000:03d}Z"


def test_images_are_listed_the_newest_first_in_pages(served: Made) -> None:
    first = served.client.get("/v1/images?limit=3").json()
    second = served.client.get(first["next"]).json()
    assert second["next"] is None
    found = first["images"] + second["images"]
    assert [datetime.fromisoformat(one["time"]) for one in found] == TIMES[::-1]
    assert all(one["bytes"] > 1000 for one in found)
    assert found[0]["calibration"] == "second"


def test_an_interval_holds_its_beginning_and_not_its_end(served: Made) -> None:
    query = {"since": name(TIMES[1]), "until": name(TIMES[3])}
    found = served.client.get("/v1/images", params=query).json()["images"]
    assert [datetime.fromisoformat(one["time"]) for one in found] == [TIMES[2], TIMES[1]]


def test_the_png_is_the_file_with_its_counts_and_metadata(served: Made) -> None:
    answer = served.client.get(f"/v1/images/{name(TIMES[1])}", headers={"accept": "image/png"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    counts = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert counts is not None
    np.testing.assert_array_equal(counts, composite(1))
    assert (embedded_document(answer.content) or {})["exposures"][2]["exposure_us"] == 48_000.0
    assert answer.headers["sunarc-exposures-us"].split(", ") == ["3000", "12000", "48000"]
    assert answer.headers["sunarc-time"].startswith("2013-05-13T21:00:00.25")
    listed = served.client.get("/v1/images").json()["images"]
    assert answer.headers.get("sunarc-calibration") == listed[2]["calibration"]
    assert "private" in answer.headers["cache-control"]


def test_the_preview_by_format_or_by_what_the_client_accepts(served: Made) -> None:
    path = f"/v1/images/{name(TIMES[0])}"
    by_format = served.client.get(path, params={"format": "jpeg"})
    by_accept = served.client.get(path, headers={"accept": "image/jpeg, text/html;q=0.5"})
    assert by_format.headers["content-type"] == by_accept.headers["content-type"] == "image/jpeg"
    assert by_format.content == by_accept.content
    assert by_format.headers["etag"] != served.client.get(path).headers["etag"]


@pytest.mark.parametrize(("width", "size"), [(16, (16, 12)), (40, (40, 30)), (4000, (80, 60))])
def test_a_thumbnail_has_the_width_and_is_never_enlarged(served: Made, width: int, size: tuple[int, int]) -> None:
    answer = served.client.get(f"/v1/images/{name(TIMES[0])}", params={"width": width})
    with Pictures.open(io.BytesIO(answer.content)) as picture:
        assert picture.format == "JPEG"
        assert picture.size == size


def test_a_thumbnail_as_png_is_one_of_8_bits(served: Made) -> None:
    answer = served.client.get(f"/v1/images/{name(TIMES[0])}", params={"width": 40, "format": "png"})
    with Pictures.open(io.BytesIO(answer.content)) as picture:
        assert (picture.format, picture.size) == ("PNG", (40, 30))
        assert picture.mode in {"L", "RGB"}


def test_a_range_of_the_file_is_sent_and_one_outside_refused(served: Made) -> None:
    path = f"/v1/images/{name(TIMES[2])}"
    whole = served.client.get(path)
    part = served.client.get(path, headers={"range": "bytes=100-299"})
    assert (part.status_code, part.content) == (206, whole.content[100:300])
    assert part.headers["content-range"] == f"bytes 100-299/{len(whole.content)}"
    assert whole.headers["accept-ranges"] == "bytes"
    last = served.client.get(path, headers={"range": "bytes=-50"})
    assert last.content == whole.content[-50:]


@pytest.mark.parametrize("text", ["bytes=9-3", "bytes=-", "lines=1-2", "bytes=0-1,5-6"])
def test_what_is_no_range_of_bytes_is_ignored(served: Made, text: str) -> None:
    path = f"/v1/images/{name(TIMES[2])}"
    answer = served.client.get(path, headers={"range": text})
    assert (answer.status_code, answer.content) == (200, served.client.get(path).content)
    past = served.client.get(path, headers={"range": f"bytes=0-{10**30}"})
    assert (past.status_code, past.content) == (206, answer.content)


@pytest.mark.parametrize("text", [f"bytes={10**9}-", "bytes=-0"])
def test_a_range_that_is_none_of_the_image_is_a_problem(served: Made, text: str) -> None:
    answer = served.client.get(f"/v1/images/{name(TIMES[2])}", headers={"range": text})
    assert answer.status_code == 416
    assert answer.json()["errors"][0]["field"] == "range"
    assert answer.headers["content-range"].startswith("bytes */")


def test_who_has_an_image_gets_304(served: Made) -> None:
    path = f"/v1/images/{name(TIMES[2])}"
    tag = served.client.get(path).headers["etag"]
    answer = served.client.get(path, headers={"if-none-match": tag})
    assert (answer.status_code, answer.content) == (304, b"")


def test_head_of_an_image_has_its_length(served: Made) -> None:
    path = f"/v1/images/{name(TIMES[2])}"
    head = served.client.request("HEAD", path)
    assert int(head.headers["content-length"]) == len(served.client.get(path).content)
    assert head.content == b""


@pytest.mark.parametrize(
    ("path", "query", "accept", "status", "field"),
    [
        (name(FIRST + timedelta(milliseconds=1)), {}, "*/*", 404, "time"),
        (name(FIRST), {}, "text/html", 406, "accept"),
        (name(FIRST), {"width": 10**9}, "*/*", 422, "width"),
        (name(FIRST), {"width": 15}, "*/*", 422, "width"),
        (name(FIRST), {"format": "tiff"}, "*/*", 422, "format"),
        ("yesterday", {}, "*/*", 422, "time"),
        ("../../token", {}, "*/*", 404, None),
    ],
)
def test_what_cannot_be_given_is_a_problem(
    served: Made, path: str, query: dict[str, object], accept: str, *, status: int, field: str | None
) -> None:
    answer = served.client.get(f"/v1/images/{path}", params=query, headers={"accept": accept})
    assert answer.status_code == status
    if field is not None:
        assert answer.json()["errors"][0]["field"] == field


def test_without_images_the_list_is_empty(made: Made) -> None:
    assert made.client.get("/v1/images").json() == {"images": [], "next": None}
    assert made.client.get(f"/v1/images/{name(FIRST)}").status_code == 404


def test_only_the_folders_of_the_dates_asked_for_are_read(store: ImageStore) -> None:
    for month in range(1, 5):
        folder = store.folder / "2012" / f"{month:02d}" / "01"
        folder.mkdir(parents=True)
    read: list[Path] = []
    days = list(store._list_day_folders(TIMES[0], TIMES[1]))
    read += days
    assert [folder.name for folder in read] == ["13"]
    assert len(list(store._list_day_folders(None, None))) == 6
    assert store.between(kind="hdr.png", limit=2) == store.between(kind="hdr.png", limit=9)[:2]
