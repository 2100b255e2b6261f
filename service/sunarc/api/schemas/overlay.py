"""What a page needs to draw over an image; units and examples as in schemas.py."""

from __future__ import annotations

from pydantic import BaseModel, Field

from sunarc.api.schemas.calibration import SunTrack
from sunarc.api.schemas.parameters import Answers, Pair, Size


class ZenithCircle(BaseModel):
    """All directions of one apparent zenith angle, as a line in the image."""

    zenith_deg: float = Field(description="Apparent zenith angle, degrees; 90 is the horizon.", examples=[60.0])
    pixels: list[Pair | None] = Field(
        description="x, y in px from north over east; null outside the field.", examples=[[[400.0, 912.5], None]]
    )


class AzimuthLine(BaseModel):
    """All directions of one azimuth, from near the zenith to the horizon, as a line in the image."""

    azimuth_deg: float = Field(description="Degrees clockwise from north.", examples=[90.0])
    name: str | None = Field(description="N, E, S or W; null between them.", examples=["E"])
    pixels: list[Pair | None] = Field(
        description="x, y in px, from the zenith outwards; null outside the field.", examples=[[[400.0, 912.5], None]]
    )


class SunPath(SunTrack):
    """The sun's way through one day, with its name."""

    name: str = Field(description="today, june solstice or december solstice.", examples=["today"])


class Overlay(BaseModel):
    """Lines to draw over an image; without a calibration there are only the sun's angles."""

    calibration: str | None = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    image_size: Size | None = Field(description="Width, height of the camera's image, px.", examples=[[1748, 1748]])
    zenith_circles: list[ZenithCircle] = Field(description="At 30, 60 and 90 degrees.")
    azimuth_lines: list[AzimuthLine] = Field(description="Every 30 degrees.")
    sun_paths: list[SunPath] = Field(description="Of today and of both solstices of the year.")


class Uncertainty(BaseModel):
    """How sure the calibration is over the image, on a coarse grid of square cells."""

    calibration: str = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    x_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    y_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    sigma_deg: list[Answers] = Field(
        description="1-sigma per axis on the sphere, degrees; a row for each y; null outside the field.",
        examples=[[[None, 0.004], [0.004, 0.003]]],
    )


class Difference(BaseModel):
    """How far the directions of two calibrations are from each other over the image, on a coarse grid of cells."""

    calibration: str = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    other: str = Field(description="Id of the one it is compared with.", examples=["20130513T150508Z"])
    x_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    y_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    difference_deg: list[Answers] = Field(
        description="Angle between the directions of a pixel, degrees; a row for each y; null outside either's field.",
        examples=[[[None, 0.004], [0.004, 0.003]]],
    )
    rms_deg: float | None = Field(description="Over the cells, degrees; null where they share none.", examples=[0.004])
    max_deg: float | None = Field(description="At most, degrees; null where they share none.", examples=[0.011])
    rotation_deg: list[float] | None = Field(
        description="Rotation about east, north and up that brings the other's directions closest to these, degrees; "
        "null where they share none.",
        examples=[[0.003, -0.001, 0.002]],
    )
    rms_rotated_deg: float | None = Field(
        description="What is left by that rotation: of the lens, RMS, degrees.", examples=[0.002]
    )
