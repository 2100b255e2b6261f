"""The moon's images of a night: small parts of them are kept, and measured when the night is over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from datetime import datetime
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance, without_clock
from sunarc.calibration.model.result import Calibration
from sunarc.common.findings import Finding
from sunarc.detection.moon import Cutout, MoonExpectation, brightest_cutouts, cutout_around, detect_moon
from sunarc.detection.values import Detection, Sensor
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.exposures import LEAST_LIT, LOWEST_DEG, MOST_LEVEL, MoonExposures
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.sky.night import MoonDisc, moon_disc

_MOST_IMAGES = 200
_NEIGHBOURHOOD, _STUCK = 3, 2
"""Pixels a side, in which two may be stuck."""
_STANDS_OUT = 3.0
"""Light of a stuck pixel over that about it, at least. The lens spreads the moon's: the third of nine pixels has half
of the brightest one's or more, behind a mosaic too (simulated half moons of 2.7 px)."""
_FEWEST = 2
"""Of a night: one alone is not compared with any other."""
_SCATTER_SIGMAS, _SEEING_PX = 4.0, 0.3
_SEARCH_SIGMAS = 4.0


class MoonNight(NamedTuple):
    """Result of a night's images of the moon: the sightings, how many images there were, and why others gave none."""

    points: tuple[SunPoint, ...]
    images: int
    refused: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _MoonImage:
    """The brightest places of the best exposure of a slot."""

    time: datetime
    exposure_us: float
    sensor: Sensor
    cutouts: tuple[Cutout, ...]
    clock_error_s: float = 0.0


class _MeasuredMoon(NamedTuple):
    """An image, the moon in it (in the whole image's pixels), and by how much it is off its prediction, px."""

    image: _MoonImage
    found: Detection
    x_px: float
    y_px: float
    off: tuple[float, float]


@dataclass(eq=False)
class MoonImages:
    """Keeps the brightest places of the night's images of the moon, and measures them with a calibration.

    Parameters
    ----------
    camera : its archive and site.
    options : the sensor.
    exposures : learns how bright the moon was.
    """

    camera: CameraArchive
    _: KW_ONLY
    options: SensorOptions
    exposures: MoonExposures | None
    _images: list[_MoonImage] = field(default_factory=list, init=False)

    def add(self, frames: Sequence[Frame]) -> tuple[Frame, tuple[Cutout, ...]]:
        """Keep the bright part of the longest exposure of a slot that is not clipped, and return both."""
        looked = [(frame, brightest_cutouts(frame.image, full_scale=frame.full_scale)) for frame in frames]
        near = self._make_prediction_filter()
        levels = [(frame, cutouts, brightest_level(frame, near(frame, cutouts))) for frame, cutouts in looked]
        if self.exposures is not None and frames:
            self.exposures.report(frames[0].time, tuple((frame.exposure_us, level) for frame, _, level in levels))
        good = [one for one in levels if 0.0 < one[2] < MOST_LEVEL]
        frame, cutouts, _ = max(good, key=lambda one: one[0].exposure_us) if good else levels[0]
        self.resume(frame, cutouts)
        return frame, cutouts

    def resume(self, frame: Frame, cutouts: tuple[Cutout, ...], *, clock_error_s: float = 0.0) -> None:
        """Keep the bright places of a frame; of one from before a restart with the bound of its time's error then."""
        image = _MoonImage(
            time=frame.time,
            exposure_us=frame.exposure_us,
            sensor=frame_sensor(frame, self.options),
            cutouts=cutouts,
            clock_error_s=clock_error_s,
        )
        self._images = [*self._images, image][-_MOST_IMAGES:]

    def _make_prediction_filter(self) -> Callable[[Frame, tuple[Cutout, ...]], tuple[Cutout, ...]]:
        """Return the image with the moon's cutout alone, where a calibration predicts it: a lamp may be brighter."""
        calibration = self.camera.archive.calibrations.current_model(self.camera.name)

        def select_predicted(frame: Frame, cutouts: tuple[Cutout, ...]) -> tuple[Cutout, ...]:
            if calibration is None:
                return cutouts
            disc = moon_disc(frame.time.timestamp(), self.camera.site_with_air_at(frame.time))
            expected = predicted_moon(calibration, disc, within_px=1.0)
            if expected is None:
                return ()
            found = cutout_around(cutouts, expected.x_px, expected.y_px, within_px=4.0 * expected.uncertainty_px)
            return () if found is None else (found,)

        return select_predicted

    def forget(self) -> int:
        """Drop the kept images, and return how many there were."""
        count, self._images = len(self._images), []
        return count

    def finish(
        self, calibration: Calibration, *, within_px: float, clock_error_s: Callable[[datetime], float]
    ) -> MoonNight:
        """Return the sightings of the moon by a calibration's prediction, and forget the images.

        Those count that are within 4 sigma of the prediction, at least two of a night, and together: no further from
        the middle of their differences than their uncertainty allows.

        Parameters
        ----------
        calibration : predicts where the moon is.
        within_px : 1-sigma that is added to the prediction's, px.
        clock_error_s : bound of the error of a frame's time, seconds.
        """
        images, self._images = self._images, []
        looked = [self._measure_moon(image, calibration, within_px) for image in images]
        measured = [one for one in looked if isinstance(one, _MeasuredMoon)]
        refused = [one for one in looked if isinstance(one, Finding)]
        if measured:
            middle = np.median([one.off for one in measured], axis=0)
            kept = [one for one in measured if _is_near(one, middle)]
            if len(kept) < _FEWEST:
                refused.append(Finding("moon_few", {"n": len(kept), "limit": _FEWEST}))
                kept = []
            measured = kept
        points = tuple(self._make_sighting(one, clock_error_s) for one in measured)
        return MoonNight(points, len(images), tuple(refused))

    def _measure_moon(self, image: _MoonImage, calibration: Calibration, within_px: float) -> _MeasuredMoon | Finding:
        disc = moon_disc(image.time.timestamp(), self.camera.site_with_air_at(image.time))
        expected = predicted_moon(calibration, disc, within_px=within_px)
        if (
            expected is None
            or disc.illuminated_fraction < LEAST_LIT
            or disc.direction[2] < np.cos(np.radians(LOWEST_DEG))
        ):
            return Finding("moon_outside")
        reach = _SEARCH_SIGMAS * expected.uncertainty_px
        cutout = cutout_around(image.cutouts, expected.x_px, expected.y_px, within_px=reach)
        if cutout is None:
            return Finding("moon_not_found", {"sigma_px": expected.uncertainty_px})
        here = MoonExpectation(
            x_px=expected.x_px - cutout.x,
            y_px=expected.y_px - cutout.y,
            uncertainty_px=expected.uncertainty_px,
            edges_px=expected.edges_px,
            cos_phase=expected.cos_phase,
        )
        found = detect_moon(cutout.image, here, sensor=image.sensor)
        if not found.accepted or found.x_px is None or found.y_px is None:
            return found.findings[0]
        x, y = found.x_px + cutout.x, found.y_px + cutout.y
        return _MeasuredMoon(image, found, x, y, (x - expected.x_px, y - expected.y_px))

    def _make_sighting(self, measured: _MeasuredMoon, clock_error_s: Callable[[datetime], float]) -> SunPoint:
        image, found = measured.image, measured.found
        return SunPoint(
            camera=self.camera.name,
            pose_epoch="",
            time=image.time,
            body="moon",
            method=found.method,
            accepted=True,
            verdict=found.verdict,
            findings=found.findings[:1],
            exposure_us=image.exposure_us,
            x_px=measured.x_px,
            y_px=measured.y_px,
            sigma_px=found.sigma_px,
            peak_fraction=found.peak_fraction,
            snr=found.snr,
            saturated_px=found.saturated_px,
            clock_error_s=max(clock_error_s(image.time), image.clock_error_s),
        )


def predicted_moon(calibration: Calibration, disc: MoonDisc, *, within_px: float) -> MoonExpectation | None:
    """Return where and how a calibration sees the moon; None outside of the image.

    Parameters
    ----------
    calibration : the camera, and how sure one is of it.
    disc : the moon.
    within_px : 1-sigma that is added to the prediction's, px.
    """
    directions = disc.direction + np.concatenate([np.zeros((1, 3)), disc.edges.T, -disc.edges.T])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    pixels, covariance = project_with_covariance(without_clock(calibration), directions)
    camera = calibration.camera
    if not np.all(np.isfinite(pixels)):
        return None
    if np.any(pixels < -0.5) or np.any(pixels > np.array([camera.width, camera.height]) - 0.5):
        return None
    own = float(np.sqrt(0.5 * np.trace(covariance[0])))
    return MoonExpectation(
        x_px=float(pixels[0, 0]),
        y_px=float(pixels[0, 1]),
        uncertainty_px=float(np.hypot(own, within_px)),
        edges_px=np.asarray(0.5 * (pixels[1:3] - pixels[3:5]).T),
        cos_phase=disc.cos_phase,
    )


def brightest_level(frame: Frame, cutouts: Sequence[Cutout]) -> float:
    """Return the level of the brightest pixel of the brightest place over full scale; 0 without one.

    Behind a mosaic it is of the brightest colour, whose few pixels a moon of a few pixels may clip alone. Two pixels
    at each other's side that are stuck count for no more than the third of their neighbourhood leaves them.
    """
    if not cutouts:
        return 0.0
    counts = cutouts[0].image.astype(np.float64)
    sky = float(np.median(counts))
    light = np.pad(counts - sky, _NEIGHBOURHOOD // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(light, (_NEIGHBOURHOOD, _NEIGHBOURHOOD))
    around = np.partition(windows.reshape(*counts.shape, -1), -_STUCK - 1, axis=-1)[..., -_STUCK - 1]
    return (float(np.max(np.minimum(counts - sky, _STANDS_OUT * around))) + sky) / frame.full_scale


def _is_near(measured: _MeasuredMoon, middle: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    allowed = _SCATTER_SIGMAS * float(np.hypot(measured.found.sigma_px or 0.0, _SEEING_PX))
    return float(np.hypot(*(np.array(measured.off) - middle))) <= allowed
