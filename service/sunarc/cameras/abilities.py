"""The abilities of a GenICam camera, in words for its installation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sunarc.cameras.exposure import ExposureControl
from sunarc.cameras.features import BLACK_LEVEL, GAIN, Pin, first, has, is_usable, temperature_c


def abilities_of(
    camera: Any,  # noqa: ANN401 - a GObject has no types
    *,
    exposure: ExposureControl,
    pins: tuple[Pin, ...],
    notes_exposures: bool,
) -> Iterator[tuple[str, str]]:
    """Yield what there is, and what of it is used."""
    width, height = camera.get_sensor_size()
    binning = "bins" if has(camera, "BinningHorizontal") else "does not bin"
    yield "sensor", f"{width}x{height} px, {binning}"
    offered = [str(name) for name in camera.dup_available_pixel_formats_as_strings()]
    left_out = [name for name in offered if not is_usable(name)]
    not_used = f" (of no use here: {', '.join(left_out)})" if left_out else ""
    yield "pixel formats", ", ".join(name for name in offered if is_usable(name)) + not_used
    for what, names in (("gain", GAIN), ("black level", BLACK_LEVEL)):
        name = first(camera, names)
        pinned = next((pin.value for pin in pins if pin.name == name), None)
        yield what, "cannot be set" if name is None else f"{name}, held at {pinned}"
    noted = (
        "noted by the camera beside each frame"
        if notes_exposures
        else "read back from the camera, and judged by brightness"
    )
    yield "exposure", f"by {exposure.feature}; {noted}"
    degrees = temperature_c(camera)
    yield "temperature", "not reported" if degrees is None else f"{degrees:.1f} °C"
    yield "held settings", ", ".join(f"{pin.name} {pin.value}" for pin in pins)
