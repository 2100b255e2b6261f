"""An imager's calibration on this computer: asked for once, evaluated here, renewed when another one is current."""

from __future__ import annotations

import time
from typing import Any

from numpy.typing import ArrayLike

from .answers import BackProjection, Projection
from .camera import CameraModel
from .imager import Imager
from .transport import ImagerError


class LocalImager:
    """Client that evaluates an imager's calibration locally, and asks the service only for a new calibration.

    Parameters
    ----------
    imager : whose calibration it is; None where `document` is all there is.
    document : a calibration document to begin with; it is asked for unless given.
    renew_s : after so many seconds it is asked whether another calibration is current: by its ETag, in a few hundred
        bytes. Where the service does not answer, the former one goes on to be used.

    Raises
    ------
    ImagerError
        The service has no calibration, or does not answer, and no document was given.
    ValueError
        Neither an imager nor a document was given; or the document is of another version.
    """

    def __init__(
        self, imager: Imager | None = None, *, document: dict[str, Any] | None = None, renew_s: float = 300.0
    ) -> None:
        if imager is None and document is None:
            raise ValueError("nothing to evaluate; give an imager, or a calibration document")
        self._imager = imager
        self._renew_s = renew_s
        self._tag: str | None = None
        self._model = None if document is None else CameraModel(document)
        self._asked_s = -float("inf")

    @property
    def model(self) -> CameraModel:
        """The calibration in use; renewed before, where its time has come."""
        now_s = time.monotonic()  # noqa: TID251 - it stands outside the service and its clock
        if self._imager is not None and now_s - self._asked_s >= self._renew_s:
            self._asked_s = now_s
            self._renew_calibration(self._imager)
        if self._model is None:
            raise ImagerError("no calibration yet", status=None)
        return self._model

    def back_project(self, pixels: ArrayLike) -> BackProjection:
        """Return the directions of pixels (..., 2)."""
        return self.model.back_project(pixels)

    def project(self, direction: ArrayLike) -> Projection:
        """Return where vectors (..., 3), east-north-up, of any length but 0, land."""
        return self.model.project(direction)

    def _renew_calibration(self, imager: Imager) -> None:
        try:
            found = imager.renewed(self._tag)
        except ImagerError:
            if self._model is None:
                self._asked_s = -float("inf")
                raise
            return
        if found is not None:
            document, self._tag = found
            self._model = CameraModel(document)
