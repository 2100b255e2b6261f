"""Camera interface, the Aravis adapter (GigE Vision, USB3 Vision), and replay of a folder of images."""

from sunarc.cameras.aravis import AravisCamera, open_aravis
from sunarc.cameras.frame import CameraCondition, CameraInfo, Frame, GainCamera, SkyCamera, full_scale_of
from sunarc.cameras.options import AravisOptions, ReplayOptions
from sunarc.cameras.packed import pack, packing_of
from sunarc.cameras.replay import ReplayCamera, SkippedFile, exposure_of_name, open_replay
from sunarc.cameras.timestamps import TAI_MINUS_UTC_S, utc_of_timestamp

__all__ = [
    "TAI_MINUS_UTC_S",
    "AravisCamera",
    "AravisOptions",
    "CameraCondition",
    "CameraInfo",
    "Frame",
    "GainCamera",
    "ReplayCamera",
    "ReplayOptions",
    "SkippedFile",
    "SkyCamera",
    "exposure_of_name",
    "full_scale_of",
    "open_aravis",
    "open_replay",
    "pack",
    "packing_of",
    "utc_of_timestamp",
]
