"""Composites of the normal exposures of a cycle, and their metadata."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from datetime import datetime
from typing import Any

import cv2

import sunarc
from sunarc.common.array_types import Image
from sunarc.common.errors import OutsideError
from sunarc.common.utc import rfc3339
from sunarc.detection.values import bayer_pattern
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue, entries
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.imaging.hdr import HdrImage, merge_hdr
from sunarc.imaging.metadata import jpeg_with, png_with
from sunarc.imaging.preview import preview
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

NOT_WRITTEN = "images_not_written"
"""Condition of a disk that refuses images."""


@dataclass(eq=False)
class ComposeWorker:
    """Merges the exposures of each cycle and writes the composite and its preview.

    Parameters
    ----------
    cycles : the frames of one cycle at a time.
    store : where composites go.
    options : the sensor.
    describe : text of a composite's file about itself.
    board : where a disk that refuses is reported.
    show : called with each composite and its time.
    """

    cycles: DropOldestQueue[Sequence[Frame]]
    _: KW_ONLY
    store: ImageStore
    options: SensorOptions
    describe: Callable[[Sequence[Frame], HdrImage], Mapping[str, Any]]
    board: StatusRegistry
    show: Callable[[Image, datetime], None] = lambda _image, _time: None

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped, and then until nothing waits."""
        for frames in entries(self.cycles, stop, heartbeat):
            if frames is not None:
                self.compose(frames)

    def compose(self, frames: Sequence[Frame]) -> None:
        """Merge the exposures of a cycle and store PNG and JPEG preview; a write error loses this composite alone."""
        sensor = frame_sensor(frames[0], self.options)
        composite = merge_hdr(
            [frame.image for frame in frames],
            [frame.exposure_us for frame in frames],
            sensor=sensor,
        )
        document = self.describe(frames, composite)
        png = png_with(
            encode(composite.image, ".png"),
            document,
            software=f"sunarc {sunarc.__version__}",
            created=document["time_utc"],
        )
        jpeg = jpeg_with(encode(preview(composite.image, bayer=sensor.bayer), ".jpg"), {**document, "preview": True})
        captured_at = frames[0].time
        try:
            self.store.write(captured_at, png, kind="hdr.png")
            self.store.write(captured_at, jpeg, kind="hdr.jpg")
        except OutsideError as error:
            self.board.set_condition(NOT_WRITTEN, condition(NOT_WRITTEN, error=str(error)))
        else:
            self.board.set_condition(NOT_WRITTEN, None)
        self.show(composite.image, captured_at)


def encode(image: Image, suffix: str) -> bytes:
    """Return an image as the bytes of a file of this kind; PNG at its fastest compression.

    That is OpenCV's own choice: level 1 named alone gives up its filter and strategy, and takes twice the time.
    """
    done, encoded = cv2.imencode(suffix, image)
    if not done:
        raise OutsideError(f"an image could not be encoded as {suffix}")
    return encoded.tobytes()


SCHEMA = "sunarc.image/1"


def image_document(
    frames: Sequence[Frame], composite: HdrImage, *, camera: str, site: Site, predictor: SunPredictor
) -> dict[str, Any]:
    """Return the document of a composite, as docs/operating.md lists it.

    Parameters
    ----------
    frames : what it was merged from, in the order taken.
    composite : the merge.
    camera, site : its name, and where it stands.
    predictor : which calibration is current, and where it puts the sun.
    """
    first = frames[0]
    return {
        "schema": SCHEMA,
        "preview": False,
        "camera": camera,
        "time_utc": rfc3339(first.time, timespec="microseconds"),
        "exposures": [
            {
                "time_utc": rfc3339(frame.time, timespec="microseconds"),
                "exposure_us": frame.exposure_us,
                "gain_db": frame.gain_db,
                "frame_id": frame.frame_id,
            }
            for frame in frames
        ],
        "pixel_format": first.pixel_format,
        "bayer": bayer_pattern(first.pixel_format),
        "counts_per_us": composite.counts_per_us,
        "saturated_px": composite.saturated_px,
        "calibration": predictor.calibration_id(),
        "sun": _describe_sun(first.time, site, predictor),
        "site": {"latitude": site.latitude, "longitude": site.longitude, "altitude": site.altitude},
        "software": {"name": "sunarc", "version": sunarc.__version__},
    }


def _describe_sun(time: datetime, site: Site, predictor: SunPredictor) -> dict[str, float | None]:
    angles = sun_angles(time.timestamp(), site)
    expected = predictor.expectation(time)
    return {
        "apparent_zenith": round(float(angles.apparent_zenith), 5),
        "azimuth": round(float(angles.azimuth), 5),
        "x_px": None if expected is None else round(expected.x_px, 3),
        "y_px": None if expected is None else round(expected.y_px, 3),
    }
