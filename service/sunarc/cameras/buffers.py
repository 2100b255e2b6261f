"""Checks of a received frame: complete, next in number, of the exposure that was set."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import Image
from sunarc.cameras.frame import CameraInfo
from sunarc.cameras.packed import packed_bytes, packing_of, unpack
from sunarc.errors import CameraError, CameraTimeoutError

_CHUNK_TOLERANCE = 0.01


def follows(previous_id: int, frame_id: int) -> bool:
    """Return whether a frame count is the next one; GigE Vision 1 counts 1 … 65535 and never says 0."""
    return frame_id == previous_id + 1 or (previous_id == 65_535 and frame_id == 1)


def require_exposure(noted_us: float, exposure_us: float) -> None:
    """Raise `CameraError` when the exposure that a frame notes of itself is not the one that was read back."""
    if not abs(noted_us - exposure_us) <= max(1.0, _CHUNK_TOLERANCE * exposure_us):
        raise CameraError(f"a frame notes an exposure of {noted_us:g} µs, not {exposure_us:g} µs")


def image_of(data: bytes, info: CameraInfo) -> Image:
    """Return the counts of a frame's bytes, which may have been cut short."""
    count, packing = info.width * info.height, packing_of(info.pixel_format)
    depth = 1 if info.full_scale == 255 else 2
    expected = count * depth if packing is None else packed_bytes(packing, count)
    if len(data) < expected:
        raise CameraError(f"a frame of {len(data)} bytes came, {expected} bytes in {info.pixel_format} are expected")
    if packing is not None:
        return _read_only(unpack(data, packing, count)).reshape(info.height, info.width)
    flat = np.frombuffer(data, np.uint8, count) if depth == 1 else np.frombuffer(data, np.uint16, count)
    return flat.reshape(info.height, info.width)


def _read_only(image: Image) -> Image:
    image.flags.writeable = False
    return image


def incomplete(status: str) -> CameraError:
    """Return the error that an unusable buffer's status stands for."""
    if status in {"timeout", "missing-packets"}:
        return CameraTimeoutError(f"packets of the frame were lost ({status}); see the network's buffer settings")
    return CameraError(f"the frame is not usable ({status})")
