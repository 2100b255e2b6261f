"""A GenICam camera brought into the one state that its frames are trusted in.

Everything here takes the library's camera object as it is (untyped): only `cameras.aravis` knows the library.
"""

from __future__ import annotations

import contextlib
from typing import Any

from sunarc.cameras.frame import CameraInfo, full_scale_of
from sunarc.cameras.options import AravisOptions
from sunarc.errors import ConfigurationError

_AUTOMATIC = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")


def pin_settings(camera: Any, options: AravisOptions) -> None:  # noqa: ANN401 - a GObject has no types
    """Switch everything automatic off, and set format, region and gain (before a stream is made)."""
    for feature in _AUTOMATIC:
        if camera.is_feature_available(feature):
            camera.set_string(feature, "Off")
    if camera.is_feature_available("GammaEnable"):
        camera.set_boolean("GammaEnable", False)
    camera.set_string("AcquisitionMode", "Continuous")
    _set_pixel_format(camera, options.pixel_format)
    _set_region(camera, options.region)
    if camera.is_feature_available("Gain"):
        low, high = camera.get_gain_bounds()
        camera.set_gain(min(max(options.gain_db, low), high))
    camera.set_trigger("Software")


def pinned_gain_db(camera: Any) -> float:  # noqa: ANN401 - a GObject has no types
    """Return the gain in decibels, 0 where the camera has only a raw one."""
    return float(camera.get_gain()) if camera.is_feature_available("Gain") else 0.0


def describe(camera: Any, *, address: str) -> CameraInfo:  # noqa: ANN401 - a GObject has no types
    """Return what the camera says of itself."""
    pixel_format = str(camera.get_pixel_format_as_string())
    _, _, width, height = camera.get_region()
    low, high = camera.get_exposure_time_bounds()
    return CameraInfo(
        address=address,
        vendor=str(camera.get_vendor_name() or ""),
        model=str(camera.get_model_name() or ""),
        serial=_serial(camera),
        width=int(width),
        height=int(height),
        pixel_format=pixel_format,
        full_scale=full_scale_of(pixel_format),
        exposure_min_us=float(low),
        exposure_max_us=float(high),
        exposure_step_us=_exposure_step_us(camera),
    )


def _set_pixel_format(camera: Any, pixel_format: str) -> None:  # noqa: ANN401 - a GObject has no types
    offered = camera.dup_available_pixel_formats_as_strings()
    if pixel_format not in offered:
        raise ConfigurationError(f"the camera has no pixel format {pixel_format}; it offers {', '.join(offered)}")
    camera.set_pixel_format_from_string(pixel_format)


def _set_region(camera: Any, region: tuple[int, int, int, int] | None) -> None:  # noqa: ANN401 - a GObject has no types
    sensor_width, sensor_height = camera.get_sensor_size()
    x, y, width, height = region or (0, 0, sensor_width, sensor_height)
    if x + width > sensor_width or y + height > sensor_height:
        raise ConfigurationError(f"the region {region} does not fit the sensor of {sensor_width}×{sensor_height} px")
    camera.set_region(0, 0, width, height)  # a smaller region first: an offset may be refused beside a full width
    camera.set_region(x, y, width, height)


def _serial(camera: Any) -> str:  # noqa: ANN401 - a GObject has no types
    for feature in ("DeviceSerialNumber", "DeviceID"):
        if camera.is_feature_available(feature):
            return str(camera.get_string(feature))
    return ""


def _exposure_step_us(camera: Any) -> float:  # noqa: ANN401 - a GObject has no types
    for feature in ("ExposureTime", "ExposureTimeAbs"):
        if camera.is_feature_available(feature):
            with contextlib.suppress(Exception):  # vendors' descriptions disagree on whether there is one
                step = float(camera.get_float_increment(feature))
                return step if 1e-6 < step < 1e6 else 0.0
    return 0.0
