"""The exposure that a frame notes of itself (a GenICam chunk), or the register's where there is none to be read."""

from __future__ import annotations

import logging
from typing import Any

from sunarc.cameras.exposure import ExposureControl

_log = logging.getLogger(__name__)
_CHUNK = "ExposureTime"


class NotedExposure:
    """Reads a frame's exposure.

    Parameters
    ----------
    camera : the library's, before its stream is made: chunks change the payload.
    control : by which the exposure is set, and read back.
    error : the library's error.
    """

    def __init__(self, camera: Any, control: ExposureControl, *, error: type[Exception]) -> None:  # noqa: ANN401 - a GObject has no types
        self._camera = camera
        self._control = control
        self._error = error
        self._parser: Any = None
        try:
            if camera.are_chunks_available():
                camera.set_chunks(_CHUNK)
                self._parser = camera.create_chunk_parser()
        except error as refused:  # a camera may have chunks and none of the exposure
            _log.info("the camera does not note its exposures: %s", refused)

    @property
    def from_frame(self) -> bool:
        """Whether frames note their exposure themselves."""
        return self._parser is not None

    def of(self, buffer: Any) -> float:  # noqa: ANN401 - a GObject
        """Return a frame's exposure in microseconds; chunks that cannot be parsed are not tried again."""
        if self._parser is not None:
            try:
                return float(self._parser.get_float_value(buffer, f"Chunk{_CHUNK}"))
            except self._error as unreadable:
                self._parser = None
                _log.warning(
                    "chunk data of the camera cannot be parsed (%s): exposures are checked by reading %s back instead",
                    unreadable,
                    self._control.feature,
                )
        return self._control.get(self._camera)
