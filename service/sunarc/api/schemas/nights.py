"""Bodies of nights."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from sunarc.api.schemas.parameters import Next, Pair, Size, Unit
from sunarc.json_fields import EXAMPLE_TIME, SolarDate, Time, described


class ZenithBandOut(BaseModel):
    """The stars of a band of zenith angles."""

    from_deg: float = Field(description="Zenith angle, degrees.", examples=[50.0])
    to_deg: float = Field(description="Zenith angle, degrees.", examples=[65.0])
    predicted: int = Field(
        description="Stars to V 4 that the calibration predicts in the images, a count.", examples=[812]
    )
    found: int = Field(description="Of them those that are detected, a count.", examples=[741])
    transparency: float | None = Field(
        description="Share of their light that arrives, of what it is outside the air; with the lens's own shading.",
        examples=[0.74],
    )


class NightImages(BaseModel):
    """Numbers of a night's images, 72 at most, in columns; null where one is not known."""

    time: list[Time] = Field(default=[], description="Middles of the exposures.", examples=[[EXAMPLE_TIME]])
    n_matched: list[int] = Field(default=[], description="Named stars, counts.", examples=[[620]])
    cloud_fraction: list[float | None] = Field(
        default=[], description="Share of the stars to V 4 that are not seen.", examples=[[0.1]]
    )
    limiting_magnitude: list[float | None] = Field(
        default=[], description="V at which half as many are detected as of the bright ones.", examples=[[5.1]]
    )
    star_fwhm_px: list[float | None] = Field(
        default=[], description="Full width at half maximum of bright stars, px.", examples=[[2.4]]
    )
    star_ellipticity: list[float | None] = Field(
        default=[], description="1 - minor / major axis, of bright stars.", examples=[[0.12]]
    )
    halo: list[float | None] = Field(
        default=[], description="Light between 4 and 7 widths around stars, over their own.", examples=[[0.01]]
    )
    zero_point: list[float | None] = Field(
        default=[], description="V of a star outside the air that gives one count a second.", examples=[[10.9]]
    )


class Night(BaseModel):
    """Verdict of a night; what is null is not known: no image of it was matched."""

    night: Annotated[SolarDate, Field(alias="date", description="Local mean solar date of the evening.")]
    verdict: Annotated[
        Literal["clear", "partly", "cloudy", "moonlit", "unusable"],
        described("`moonlit`: no stars were named, and a moon more than half lit was up.", "clear"),
    ]
    n_images: Annotated[int, described("Exposures of the night, a count.", 48)]
    n_accepted: Annotated[int, described("Of them those whose stars were named, a count.", 46)] = 0
    n_stored: Annotated[int, described("Sightings of stars and planets that were stored, a count.", 1380)] = 0
    n_moon_images: Annotated[int, described("Slots with exposures of the moon, a count.", 12)] = 0
    n_moon_stored: Annotated[int, described("Sightings of the moon that were stored, a count.", 12)] = 0
    n_warm_pixels: Annotated[int, described("Warm pixels that were repaired in its images, a count.", 310)] = 0
    star_offset_px: Annotated[
        float | None, described("By how much the stars' centres lie outside of their prediction, at most, px.", 0.1)
    ] = None
    n_stars: Annotated[int, described("Detections in an accepted image, median.", 1730)] = 0
    n_matched: Annotated[int, described("Named stars in an accepted image, median.", 620)] = 0
    limiting_magnitude: Annotated[float | None, described("V to which half of the stars are detected.", 5.5)] = None
    star_fwhm_px: Annotated[float | None, described("Full width of the stars at half maximum, px.", 2.4)] = None
    cloud_fraction: Annotated[
        float | None, described("Share of the stars to V 4 that are not seen; 1 in images without named stars.", 0.1)
    ] = None
    transparency: Annotated[
        float | None,
        described("Share of the light that comes through one air mass, by the stars' brightness over the sky.", 0.83),
    ] = None
    extinction: Annotated[
        float | None, described("Loss of light, magnitudes an air mass, with the shading of the lens.", 0.21)
    ] = None
    extinction_sigma: Annotated[float | None, described("1-sigma of the extinction, magnitudes.", 0.01)] = None
    zero_point: Annotated[
        float | None, described("V of a star outside the air that gives one count a second, median.", 10.9)
    ] = None
    star_ellipticity: Annotated[
        float | None, described("1 - minor / major axis of bright stars, median of the images.", 0.12)
    ] = None
    halo: Annotated[
        float | None, described("Light between 4 and 7 widths around stars over their own, median.", 0.01)
    ] = None
    width_growth: Annotated[
        float | None, described("Width of the stars in the last third of the images over the first.", 1.02)
    ] = None
    halo_growth: Annotated[
        float | None, described("Growth of the halo from the first to the last third of the images.", 0.002)
    ] = None
    fading_mag: Annotated[
        float | None, described("Loss of brightness from the first to the last third, magnitudes.", 0.05)
    ] = None
    picture: Annotated[bool, described("Whether /v1/nights/{night}/image has a picture of it.", True)] = False
    zenith_bands: Annotated[list[ZenithBandOut], described("Stars by zenith angle; empty where none were named.")] = []
    images: Annotated[
        NightImages | None, described("Numbers of its images; null where not asked for, or not known.")
    ] = None
    findings: Annotated[list[dict[str, Any]], described("Why, as codes and data.", [{"code": "night_images"}])]
    decided_at: Annotated[Time, described("When the night was judged, by the frames' time.", EXAMPLE_TIME)]


class NightBody(BaseModel):
    """A star, a planet or the moon in the picture of a night."""

    body: str = Field(description="As in the sightings.", examples=["star:HIP32349"])
    title: str = Field(description="What a person calls it.", examples=["Sirius"])
    pixel: Pair = Field(description="Where it is predicted, x, y in px of the camera.", examples=[[400.0, 912.5]])
    magnitude: float = Field(description="V, of stars and planets with the air's extinction.", examples=[-1.4])
    found: bool | None = Field(
        description="Whether it was detected; null where no star of the picture was named, and of the moon.",
        examples=[True],
    )
    lit: float | None = Field(default=None, description="Of the moon, the share that is lit.", examples=[0.4])


class NightBodies(BaseModel):
    """What is in the picture of a night: stars to V 3.5, planets, the moon."""

    time: Annotated[Time, Field(description="Middle of the exposure of the picture.")]
    calibration: str | None = Field(
        description="Id of the calibration that predicted them.", examples=["20130514T150508Z"]
    )
    image_size: Size | None = Field(description="Width, height of the camera's image, px.", examples=[[1748, 1748]])
    bodies: list[NightBody] = Field(description="The moon first, then the brightest; empty without a calibration.")


class NightPose(BaseModel):
    """How the camera stands at night against the day, by the sightings of all nights of a calibration."""

    calibration: str = Field(description="Id of the calibration.", examples=["20130514T150508Z"])
    n: int = Field(description="Sightings of nights that it used, a count.", examples=[150])
    pose_difference_deg: Unit = Field(
        description="Turn against the day about east, north and up, degrees.", examples=[[0.004, -0.011, 0.002]]
    )
    pose_sigma_deg: Unit = Field(description="1-sigma of each, degrees.", examples=[[0.002, 0.002, 0.003]])


class Nights(BaseModel):
    """Nights, the newest first; a night that was judged again is listed once, as it was judged last."""

    nights: Annotated[list[Night], described("On this page, the newest first.")]
    pose: Annotated[
        NightPose | None,
        described("By the calibration that is served; null without one, or where it used no sightings of a night."),
    ] = None
    next: Next
