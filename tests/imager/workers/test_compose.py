"""Composites: merged, described, written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from PIL import Image as Pictures
from tests.fixtures.archive import make_empty

from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.workers.compose import ComposeWorker, image_document
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.imaging.hdr import HdrImage
from sunarc.imaging.metadata import embedded_document
from sunarc.sky.site import Site

from .conftest import NOON

if TYPE_CHECKING:
    from sunarc.imager.runtime.status import StatusRegistry

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
EXPOSURES_US = (3_000.0, 12_000.0, 48_000.0)


def cycle(number: int = 0, *, pixel_format: str = "Mono12", size: int = 40) -> list[Frame]:
    scene = np.linspace(0.01, 0.3, size * size).reshape(size, size)
    return [
        Frame(
            image=np.minimum(np.rint(scene * exposure_us), 4095).astype(np.uint16),
            time=NOON + timedelta(seconds=30 * number, microseconds=exposure_us / 2.0),
            exposure_us=exposure_us,
            gain_db=1.5,
            pixel_format=pixel_format,
            full_scale=4095,
            frame_id=index,
        )
        for index, exposure_us in enumerate(EXPOSURES_US)
    ]


@pytest.fixture
def predictor(tmp_path: Path) -> SunPredictor:
    make_empty(tmp_path / "sunarc.sqlite")
    return SunPredictor(CameraArchive(open_archive(tmp_path / "sunarc.sqlite"), name="roof", site=SGP))


def composer(store: ImageStore, predictor: SunPredictor, board: StatusRegistry) -> ComposeWorker:
    def describe(frames: Sequence[Frame], composite: HdrImage) -> dict[str, object]:
        return image_document(frames, composite, camera="roof", site=SGP, predictor=predictor)

    return ComposeWorker(
        DropOldestQueue(capacity=4), store=store, options=SensorOptions(), describe=describe, board=board
    )


@pytest.mark.parametrize("pixel_format", ["Mono12", "BayerRG12"])
def test_a_composite_is_linear_in_light_and_says_how_it_was_made(
    tmp_path: Path, predictor: SunPredictor, board: StatusRegistry, pixel_format: str
) -> None:
    store = ImageStore(tmp_path / "images")
    composer(store, predictor, board).compose(cycle(pixel_format=pixel_format))
    path = store.newest(kind="hdr.png")
    assert path is not None
    document = embedded_document(path.read_bytes())
    assert document is not None
    counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert counts is not None
    light = counts.astype(float) * document["counts_per_us"]
    scene = np.linspace(0.01, 0.3, 1600).reshape(40, 40)
    assert np.abs(light - scene).max() < 0.005
    assert [taken["exposure_us"] for taken in document["exposures"]] == list(EXPOSURES_US)
    assert {taken["gain_db"] for taken in document["exposures"]} == {1.5}
    assert document["time_utc"] == "2013-05-13T18:30:10.001500Z"
    assert document["bayer"] == ("RGGB" if pixel_format.startswith("Bayer") else None)
    assert document["sun"]["apparent_zenith"] == pytest.approx(
        36.604 - 18.5, abs=0.1
    )  # latitude less declination, at noon
    assert (document["calibration"], document["sun"]["x_px"]) == (None, None)


def test_the_preview_says_the_same_as_the_composite(
    tmp_path: Path, predictor: SunPredictor, board: StatusRegistry
) -> None:
    store = ImageStore(tmp_path / "images")
    composer(store, predictor, board).compose(cycle())
    composite, shown = store.newest(kind="hdr.png"), store.newest(kind="hdr.jpg")
    assert composite is not None
    assert shown is not None
    with Pictures.open(shown) as picture:
        said = json.loads(picture.info["comment"])
    assert {**said, "preview": False} == embedded_document(composite.read_bytes())
    assert said["preview"]


def test_a_disk_without_room_costs_composites_and_is_told_until_there_is_room(
    tmp_path: Path, predictor: SunPredictor, board: StatusRegistry
) -> None:
    free = [0]
    options = DiskOptions(keep_free_mb=2.0, reserve_mb=1.0)
    store = ImageStore(tmp_path / "images", options=options, free_bytes=lambda _: free[0])
    made = composer(store, predictor, board)
    made.compose(cycle(0))
    assert [reason.code for reason in board.snapshot().reasons] == ["images_not_written"]
    free[0] = 10_000_000
    made.compose(cycle(1))
    assert board.snapshot().reasons == ()
    assert len(list((tmp_path / "images").rglob("*_hdr.*"))) == 2
