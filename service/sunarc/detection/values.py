"""Input and output of the detection of sun and stars."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Le

from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray, NameArray, picked
from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, joined

Method = Literal["disc", "paper"]
Verdict = Literal[
    "clear",
    "veiled",
    "partly_covered",
    "hidden",
    "obstructed",
    "saturated",
    "below_horizon",
    "reflection",
    "elsewhere",
    "frozen",
    "no_frame",
    "in_stack",
]
Bayer = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
BAYERS: tuple[Bayer, ...] = get_args(Bayer)


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Result of a search for the sun, or for the moon (`moon`), in one image.

    Attributes
    ----------
    method : detector that was used.
    accepted : whether fits may use the position.
    verdict : classification of what the image shows at the sun's (the moon's) place.
    findings : what decided, as codes and data; the first is the main one.
    x_px, y_px : centre of the disc, lit or not; None where none was found. A rejected position may be given.
    sigma_px : 1-sigma per axis.
    peak_fraction : level of the disc's centre over full scale; above 1 where it is extrapolated from masked saturation.
    background_fraction : level around the disc over full scale.
    radius_px : geometric mean of the disc's (`paper`: the saturated blob's) semi-axes.
    ellipticity : 1 - minor/major semi-axis.
    residual_chi2 : reduced chi² of the fit (`disc`, `moon`), None else.
    snr : the light's flux over its standard deviation (`disc`, `moon`), None else.
    saturated_px : number of saturated pixels in the window.
    spread_px : rms distance of the centres from their median: of the circles at the rim's levels, or of the paper's
        estimators where these are asked for (`paper`), None else.
    exposure_us : exposure time, as the caller gave it.
    """

    method: Method | Literal["moon"]
    accepted: bool
    verdict: Verdict
    findings: tuple[Finding, ...]
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None
    peak_fraction: float | None = None
    background_fraction: float | None = None
    radius_px: float | None = None
    ellipticity: float | None = None
    residual_chi2: float | None = None
    snr: float | None = None
    saturated_px: int = 0
    spread_px: float | None = None
    exposure_us: float | None = None

    @property
    def reason(self) -> str:
        """Deciding finding, in a sentence."""
        return joined(self.findings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightFit:
    """Result of the least-squares fit of a light, the sun's disc or the moon; `Stars` has it in columns.

    Attributes
    ----------
    x_px, y_px : centre, px; (0, 0) is the centre of the top-left pixel.
    sigma_px : its 1-sigma per axis, with the reduced chi² where that is larger than chance has it.
    width_px : 1-sigma of the point spread.
    snr : flux over its standard deviation.
    chi2 : reduced.
    residual : rms of the residuals over the light's level.
    """

    x_px: float
    y_px: float
    sigma_px: float
    width_px: float
    snr: float
    chi2: float
    residual: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """Properties of the sensor that the detectors use.

    Attributes
    ----------
    full_scale : the largest count (255, 1023, 4095, 65535).
    gain_e_per_count : electrons per count; of averaged pixels those of all of them together.
    read_noise_e : electrons, rms; likewise.
    black_level : counts without light.
    bayer : colours of the top-left 2×2 pixels, row by row; None for mono.
    blooming : a saturated pixel spills into its neighbours, so that they are masked too.
    binning : pixels that the camera averages in either direction: a mean of clipped pixels lies below full scale.
    """

    full_scale: int
    gain_e_per_count: float
    read_noise_e: float = 12.0
    black_level: float = 0.0
    bayer: Bayer | None = None
    blooming: bool = False
    binning: int = 1

    def __post_init__(self) -> None:
        """Refuse values that no sensor has."""
        if self.binning < 1:
            raise InputError(field="sensor", problem=f"binning {self.binning} is below 1", remedy="give 1 or more")
        numbers = (self.gain_e_per_count, self.read_noise_e, self.black_level)
        if not all(math.isfinite(number) for number in numbers) or self.gain_e_per_count <= 0.0:
            raise InputError(field="sensor", problem="gain or noise is not a positive number", remedy="give electrons")
        if not 0.0 <= self.black_level < self.full_scale <= 65535 or self.read_noise_e < 0.0:
            raise InputError(
                field="sensor",
                problem="black level, full scale or noise out of range",
                remedy="give counts up to 65535",
            )

    @classmethod
    def from_full_well(cls, *, full_scale: int, full_well_e: float = 20_000.0, bayer: Bayer | None = None) -> Sensor:
        """Return a sensor whose full scale is `full_well_e` electrons."""
        return cls(full_scale=full_scale, gain_e_per_count=full_well_e / full_scale, bayer=bayer)


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """Predicted pixel and appearance of the sun.

    Attributes
    ----------
    x_px, y_px : predicted pixel.
    uncertainty_px : 1-sigma per axis of the prediction.
    stretch_px_per_rad : the lens's local 2×2 matrix, from small angles on the sphere to pixels; None where unknown.
    apparent_zenith : radians; None where unknown.
    clear_peak_fraction : the clear-sky sun's level at this exposure over full scale; None where unknown.
    """

    x_px: float
    y_px: float
    uncertainty_px: float = 2.0
    stretch_px_per_rad: tuple[tuple[float, float], tuple[float, float]] | None = None
    apparent_zenith: float | None = None
    clear_peak_fraction: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite."""
        stretch = [number for row in self.stretch_px_per_rad or () for number in row]
        numbers = (self.x_px, self.y_px, self.uncertainty_px, *stretch)
        if not all(math.isfinite(number) for number in numbers) or self.uncertainty_px < 0.0:
            raise InputError(
                field="expectation", problem="not finite", remedy="leave the prediction out where there is none"
            )


def bayer_pattern(pixel_format: str) -> Bayer | None:
    """Return the colours of a GenICam pixel format ("BayerRG8", …); None for mono."""
    patterns: dict[str, Bayer] = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}
    return patterns.get(pixel_format[5:7]) if pixel_format.startswith("Bayer") else None


def require_raw(image: Image, sensor: Sensor) -> None:
    """Raise InputError unless the image is a (rows, columns) array of the sensor's counts."""
    if image.ndim != 2 or min(image.shape) < 1:
        raise InputError(
            field="image", problem=f"its shape is {image.shape}", remedy="give one raw plane: rows and columns"
        )
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(field="image", problem=f"its type is {image.dtype}", remedy="give uint8 or uint16")
    if image.dtype == np.uint8 and sensor.full_scale > 255:
        raise InputError(
            field="image",
            problem=f"8 bits cannot hold a full scale of {sensor.full_scale}",
            remedy="correct full_scale",
        )


def require_photo(image: Image, *, full_scale: int, bayer: Bayer | None = None) -> None:
    """Raise InputError unless the image is a (rows, columns) or (rows, columns, 3) array that holds the full scale.

    A raw mosaic has 2 x 2 pixels or more: a cell of its colours.
    """
    if image.ndim not in {2, 3} or (image.ndim == 3 and image.shape[2] != 3) or min(image.shape) < 1:
        raise InputError(
            field="image", problem=f"its shape is {image.shape}", remedy="give rows, columns (and 3 colours)"
        )
    if bayer is not None and image.ndim == 2 and min(image.shape) < 2:
        raise InputError(field="image", problem=f"its shape is {image.shape}", remedy="give 2 x 2 px of a mosaic")
    if image.dtype not in (np.uint8, np.uint16) or not 0 < full_scale <= np.iinfo(image.dtype).max:
        raise InputError(
            field="image", problem=f"{image.dtype} with full scale {full_scale}", remedy="give uint8 or uint16 counts"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscOptions:
    """Prior of the sun in microsecond frames; the limits of its detection are constants (`disc.detect`).

    Attributes
    ----------
    clear_level_per_us : the clear sun's level over full scale in 1 µs, at the gain in use; 0 where unknown. The
        reference for the brightness where the prediction has none.
    """

    clear_level_per_us: Annotated[float, Ge(0.0), Le(1e6)] = 0.0

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        require_bounds(self, section_path="detection")


FWHM = 2.355
"""Full width at half maximum of a Gaussian, in its sigmas: 2 sqrt(2 ln 2)."""
MOST_PEAK = 0.9
"""Share of full scale: a star with a brighter peak may be clipped in part, and many sensors are not linear there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stars:
    """Point sources of one image, the brightest first.

    Attributes
    ----------
    pixels : (n, 2) centres, px; (0, 0) is the centre of the top-left pixel.
    sigma_px : (n,) 1-sigma per axis.
    flux : (n,) counts above the background.
    snr : (n,) flux over its standard deviation.
    peak_fraction : (n,) the brightest pixel over full scale, with the background.
    width_px : (n,) 1-sigma of the point spread, geometric mean of its axes: the star's own where it is bright enough
        (20 times the noise), else that of its place in the image.
    ellipticity : (n,) 1 - minor / major axis, likewise.
    saturated : (n,) whether pixels of it were clipped; such a centre is pulled along the coma by up to half a pixel.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    flux: FloatArray
    snr: FloatArray
    peak_fraction: FloatArray
    width_px: FloatArray
    ellipticity: FloatArray
    saturated: BoolArray

    def __len__(self) -> int:
        return int(self.flux.size)

    @property
    def sound(self) -> BoolArray:
        """Stars that are neither clipped nor near full scale, (n,)."""
        return np.asarray(~self.saturated & (self.peak_fraction < MOST_PEAK))

    def select(self, which: BoolArray | IntArray) -> Stars:
        """Return those that a mask or an index picks."""
        return picked(self, which)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedStars:
    """Where the stars above the horizon should be in an image, the brightest first.

    Attributes
    ----------
    names : (n,).
    pixels : (n, 2) px; those outside the image are left out before.
    sigma_px : (n,) 1-sigma per axis of the prediction.
    magnitude : (n,) V with the air's extinction.
    azimuth_deg : (n,).
    """

    names: NameArray
    pixels: FloatArray
    sigma_px: FloatArray
    magnitude: FloatArray
    azimuth_deg: FloatArray

    def __len__(self) -> int:
        return int(self.magnitude.size)

    def select(self, which: BoolArray | IntArray) -> PredictedStars:
        """Return those that a mask or an index picks."""
        return picked(self, which)
