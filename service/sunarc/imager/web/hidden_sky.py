"""Hidden sky in a camera's images: by a drawn mask, else by the learned one."""

from __future__ import annotations

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray
from sunarc.common.errors import OutsideError
from sunarc.common.foreign_files import read_regular
from sunarc.imager.archive.obstructions import LearnedObstructions
from sunarc.imager.archive.values import CalibrationRecord
from sunarc.imager.web.context import ApiContext
from sunarc.imaging.preview import decoded


def hidden_by_obstructions(context: ApiContext, record: CalibrationRecord) -> BoolArray | None:
    """Return (rows, columns): which pixels are hidden: by `api.obstruction_mask`, else as the images have shown.

    None where neither is there.
    """
    if record.camera != context.camera:
        return None
    camera = context.ready.get(record).camera
    drawn = drawn_mask(context, (camera.width, camera.height))
    if drawn is not None:
        return drawn
    learned = learned_mask(context, record)
    return None if learned is None else learned.mask.hidden()


def drawn_mask(context: ApiContext, size: tuple[int, int]) -> BoolArray | None:
    """Return (rows, columns): which pixels `api.obstruction_mask` hides; None where it is unset.

    Raises
    ------
    OutsideError
        It cannot be read, or is not an image of the size (width, height).
    """
    path = context.options.obstruction_mask
    if path is None:
        return None
    try:
        image = decoded(read_regular(path), cv2.IMREAD_GRAYSCALE)
    except OSError as error:
        raise OutsideError(f"api.obstruction_mask {path}: {error.strerror}") from error
    if image is None or image.shape[::-1] != size:
        raise OutsideError(f"api.obstruction_mask {path}: is not an image of {size[0]}x{size[1]} pixels")
    return np.asarray(image == 0)


def learned_mask(context: ApiContext, record: CalibrationRecord) -> LearnedObstructions | None:
    """Return the learned mask where a calibration has the pose epoch of the mask's own."""
    found = None if context.obstructions is None else context.obstructions.learned
    return found if found is not None and found.pose_epoch == (record.pose_epoch or "") else None


def obstructions_key(context: ApiContext, record: CalibrationRecord) -> str:
    """Return a text that identifies the mask of `hidden_by_obstructions`; empty without a mask."""
    if record.camera != context.camera:
        return ""
    path, learned = context.options.obstruction_mask, learned_mask(context, record)
    if path is not None:
        return f"{path} {path.stat().st_mtime_ns if path.exists() else None}"
    return "" if learned is None else learned.time.isoformat()
