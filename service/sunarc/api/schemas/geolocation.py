"""What is asked and answered about clouds and their shadows."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, model_validator

from sunarc.api.schemas.parameters import Answers, Body, Number, Pair, Pixel
from sunarc.json_fields import Time, described

Height = Annotated[Number, Field(gt=0.0, le=30_000.0, description="Of the cloud base above the camera's altitude, m.")]
HeightSigma = Annotated[
    Number, Field(ge=0.0, le=10_000.0, description="1-sigma of the height, the same error for all points, m.")
]
Point = Annotated[list[Number], Field(min_length=3, max_length=3, description="x, y in px, cloud base height in m.")]


class GeolocateRequest(Body):
    """Pixels and the height of the cloud base that they see: one for all (height_m), or one each (points)."""

    pixels: list[Pixel] | None = Field(
        default=None, description="(n, 2) px; with height_m.", examples=[[[400.0, 912.5]]]
    )
    height_m: Height | None = Field(default=None, description="Of all pixels, m.", examples=[1500.0])
    points: list[Point] | None = Field(
        default=None,
        description="(n, 3) px, px, metres, in place of pixels and height_m; no place for a height of 0 or less.",
        examples=[[[400.0, 912.5, 1500.0]]],
    )

    height_sigma_m: HeightSigma = Field(default=0.0, examples=[100.0])
    at: list[Time] | None = Field(
        default=None,
        description="A time for each point: it chooses the calibration and the sun; in place of the query's `at`, "
        "without draws.",
        examples=[["2013-05-13T18:30:00Z"]],
    )

    @model_validator(mode="after")
    def _one_way(self) -> GeolocateRequest:
        if (self.pixels is None, self.height_m is None) == (self.points is not None,) * 2:
            return self
        raise ValueError("give pixels and height_m, or points")


class SunPlace(BaseModel):
    """Where the sun stands that casts the shadows."""

    apparent_zenith: float = Field(description="With refraction, degrees.", examples=[18.2])
    azimuth: float = Field(description="Degrees clockwise from north.", examples=[178.1])


class SunPlaces(BaseModel):
    """Where the sun stands at the time of each point."""

    apparent_zenith: list[float] = Field(description="With refraction, degrees.", examples=[[18.2]])
    azimuth: list[float] = Field(description="Degrees clockwise from north.", examples=[[178.1]])


class Each(BaseModel):
    """What answered for each point, where each has a time."""

    calibration: list[str] = Field(
        description="Ids of the calibrations that answered.", examples=[["20130514T150508Z-52ee44"]]
    )
    time: list[Time] = Field(description="The times that were asked for.", examples=[["2013-05-13T18:30:00Z"]])
    sun: SunPlaces = Field(description="Where the sun stands then, degrees.")


class Places(BaseModel):
    """Where clouds, or shadows, are. null where there is no place."""

    east_m: Answers = Field(description="East of the camera, m.", examples=[[1204.1]])
    north_m: Answers = Field(description="North of the camera, m.", examples=[[-310.7]])
    up_m: Answers = Field(
        description="Above the camera's horizontal plane, m; less than the height far away.", examples=[[1499.8]]
    )
    latitude: Answers = Field(description="Degrees, north positive, WGS 84.", examples=[[36.6012]])
    longitude: Answers = Field(description="Degrees, east positive, WGS 84.", examples=[[-97.4714]])
    altitude: Answers = Field(description="Metres, on the same scale as the camera's.", examples=[[1818.0]])
    sigma_m: Answers = Field(
        description="1-sigma per axis on the ground, by the calibration and the height, m.", examples=[[0.2]]
    )
    covariance_m2: list[Annotated[list[Pair], Field(min_length=2, max_length=2)] | None] = Field(
        description="Covariance of east and north, by the calibration and the height, square metres.",
        examples=[[[[0.04, 0.0], [0.0, 0.04]]]],
    )


class PlaceDraws(BaseModel):
    """Where clouds, or shadows, are by each draw, the first axis; null where there is no place."""

    east_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1204.1], [1204.5]]])
    north_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[-310.7], [-310.2]]])
    up_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1499.8], [1499.8]]])
    latitude: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[36.6012], [36.6012]]])
    longitude: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[-97.4714], [-97.4714]]])
    altitude: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1818.0], [1818.0]]])


class GeolocateDraws(BaseModel):
    """Clouds and shadows by each draw of the calibration and of the height."""

    cloud: PlaceDraws = Field(description="Where the clouds are.")
    shadow: PlaceDraws = Field(description="Where their shadows are.")


class GeolocateAnswer(BaseModel):
    """Where clouds and their shadows are."""

    calibration: Annotated[str, described("Id of the calibration that answered.", "20130514T150508Z-52ee44")]
    time: Time
    sun: SunPlace = Field(description="Where the sun stands, degrees.")
    cloud: Places = Field(description="Where the clouds are, metres and degrees.")
    shadow: Places = Field(description="Where their shadows are, metres and degrees.")
    draws: GeolocateDraws | None = Field(default=None, description="Present where draws were asked for.")
    each: Each | None = Field(
        default=None,
        description="Present where each point has a time; `calibration`, `time` and `sun` are then the first one's.",
    )
