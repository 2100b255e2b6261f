"""Bodies of nights."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from sunarc.api.schemas.parameters import Next
from sunarc.json_fields import EXAMPLE_TIME, SolarDate, Time, described


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
    findings: Annotated[list[dict[str, Any]], described("Why, as codes and data.", [{"code": "night_images"}])]
    decided_at: Annotated[Time, described("When the night was judged, by the frames' time.", EXAMPLE_TIME)]


class Nights(BaseModel):
    """Nights, the newest first."""

    nights: Annotated[list[Night], described("On this page, the newest first.")]
    next: Next
