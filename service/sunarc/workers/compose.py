"""From the normal exposures of a cycle to one composite on disk."""

from __future__ import annotations

import logging
import shutil
import threading
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.archive import ImageStore
from sunarc.board import Reason, StatusBoard
from sunarc.cameras import Frame
from sunarc.errors import OutsideError
from sunarc.imaging import merge_hdr, preview
from sunarc.workers.handover import Handover
from sunarc.workers.sensor import SensorOptions, sensor_of

_log = logging.getLogger(__name__)
_POLL_S = 0.5


class ComposeWorker:
    """Merges the exposures of each cycle and writes the composite and its preview.

    Parameters
    ----------
    cycles : the frames of one cycle at a time.
    store : where composites go.
    options : the sensor.
    board : where a full disk is reported.
    """

    def __init__(
        self, cycles: Handover[Sequence[Frame]], *, store: ImageStore, options: SensorOptions, board: StatusBoard
    ) -> None:
        self._cycles = cycles
        self._store = store
        self._options = options
        self._board = board

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped, and then until nothing waits."""
        while True:
            heartbeat()
            frames = self._cycles.get(timeout_s=_POLL_S)
            if frames is not None:
                self._compose(frames)
            elif stop.is_set():
                return

    def _compose(self, frames: Sequence[Frame]) -> None:
        sensor = sensor_of(frames[0], self._options)
        composite = merge_hdr(
            [frame.image for frame in frames],
            [frame.exposure_us for frame in frames],
            sensor=sensor,
        )
        captured_at = frames[0].time
        try:
            self._store.write(captured_at, encode(composite.image, ".png"), kind="hdr.png")
            self._store.write(captured_at, encode(preview(composite.image, bayer=sensor.bayer), ".jpg"), kind="hdr.jpg")
        except OutsideError as error:
            _log.warning("%s", error)
            self._board.set_reason(
                Reason(
                    code="images_not_written",
                    severity="degraded",
                    text=str(error),
                    remedy="free space on the disk of the state folder, or make it writable",
                )
            )
            return
        self._board.clear_reason("images_not_written")
        self._board.note(disk_free_bytes=shutil.disk_usage(self._store.folder).free)


def encode(image: NDArray[np.uint8] | NDArray[np.uint16], suffix: str) -> bytes:
    """Return an image as the bytes of a file of this kind; PNG at its fastest compression."""
    done, encoded = cv2.imencode(suffix, image, [cv2.IMWRITE_PNG_COMPRESSION, 1] if suffix == ".png" else [])
    if not done:
        raise OutsideError(f"an image could not be encoded as {suffix}")
    return encoded.tobytes()
