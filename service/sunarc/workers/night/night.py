"""The worker of the night: finds the stars in its images, names them when it is over, and stores them as sightings."""

from __future__ import annotations

import logging
import math
import threading
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import date, datetime
from pathlib import Path

import numpy as np

from sunarc.archive import CameraArchive, ImageStore, Refit, SunPoint
from sunarc.calibration import (
    Calibration,
    MatchedView,
    StarView,
    match_views,
)
from sunarc.cameras import Frame
from sunarc.detection import NightLimits, Stars, detect_stars, star_halo
from sunarc.findings import Finding
from sunarc.runtime.status import StatusRegistry
from sunarc.sky import solar_date, wanderer_place
from sunarc.utc import DAY_S, rfc3339
from sunarc.workers.messages import MESSAGES, text_of
from sunarc.workers.night.exposures import DARK_ZENITH_DEG, NightCapture
from sunarc.workers.night.moon import MoonImages
from sunarc.workers.night.named_stars import BENT_PX, star_view, surest_named
from sunarc.workers.night.night_conditions import NIGHTS_COMPARED, night_conditions
from sunarc.workers.night.numbers import TakenImage, numbers_of
from sunarc.workers.night.offset import offset_of
from sunarc.workers.night.picture import NightPicture, better, named_bodies, night_picture, store_picture
from sunarc.workers.night.verdict import NightVerdict, decide_night, summary_of
from sunarc.workers.night.warm import WarmPixelMap
from sunarc.workers.night.warm_file import WarmPixelFile
from sunarc.workers.sensor import SensorOptions, sensor_of

_log = logging.getLogger(__name__)

_POLL_S = 0.5
_MOST_IMAGES = 200
_WORTH_A_REFIT: frozenset[NightVerdict] = frozenset({"clear", "partly"})
_ENOUGH_STARS = 50
_HALF_LIT = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Image:
    """An image of the night, without its pixels."""

    time: datetime
    exposure_us: float
    gain_db: float
    stars: Stars
    halo: float


class NightWorker:
    """Detects the stars in each image of the night; when the sun is back, names them and stores the verdict.

    The calibration that is served then predicts the stars of the whole night: on the first night of a camera there is
    none before midnight. A restart during the night loses its images until then.

    Parameters
    ----------
    capture : the frames of the night, and what chooses their exposures.
    camera : its archive and site.
    options : the sensor.
    apparent_zenith : the sun's, degrees, at a frame time.
    clock_error_s : bound of the error of a frame's time, seconds.
    trusted : whether the clock that dates the frames is.
    now : frame time.
    request_refit : asks for a refit, with the reason.
    board : where a focus that got worse, or dew, degrades the service.
    limits : what is suspected.
    store : where the picture of the night goes; None: nowhere.
    replaces : whether sightings take the place of former ones of their images.
    warm_pixels : file of the camera's warm pixels; None: they are forgotten with a restart.
    """

    def __init__(
        self,
        capture: NightCapture,
        *,
        camera: CameraArchive,
        options: SensorOptions,
        apparent_zenith: Callable[[], float],
        clock_error_s: Callable[[datetime], float],
        trusted: Callable[[], bool],
        now: Callable[[], datetime],
        request_refit: Callable[[str], Refit],
        board: StatusRegistry,
        limits: NightLimits | None = None,
        store: ImageStore | None = None,
        warm_pixels: Path | None = None,
        replaces: bool = False,
    ) -> None:
        self._frames, self._exposures = capture.frames, capture.exposures
        self._camera = camera
        self._options = options
        self._apparent_zenith = apparent_zenith
        self._clock_error_s = clock_error_s
        self._trusted = trusted
        self._now = now
        self._request_refit = request_refit
        self._board = board
        self._limits = limits or NightLimits()
        self._store_images = store
        self._replaces = replaces
        self._images: list[_Image] = []
        self._picture: NightPicture | None = None
        self._warm = WarmPixelMap(None if warm_pixels is None else WarmPixelFile(warm_pixels, self._report))
        self._serial: str | None = None
        self._digest: int | None = None
        self._repeated = 0
        self._moon_frames = None if capture.moon is None else capture.moon.frames
        exposures = None if capture.moon is None else capture.moon.exposures
        self._moon = MoonImages(camera, options=options, exposures=exposures)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped."""
        self.publish_conditions()
        while not stop.is_set():
            heartbeat()
            frame = self._frames.get(timeout_s=_POLL_S)
            if self._moon_frames is not None and (moon := self._moon_frames.get(timeout_s=0.0)) is not None:
                self.look_at_moon(moon)
            if frame is not None:
                self.look_at(frame)
            elif self._images and self._apparent_zenith() < DARK_ZENITH_DEG:
                self.finish(heartbeat)

    def look_at(self, frame: Frame) -> None:
        """Detect the stars of a frame, and remember them."""
        if self._is_repeated(frame):
            return
        sensor = sensor_of(frame, self._options)
        stars = detect_stars(
            self._warm.repair(frame, sensor.bayer, serial=self._camera_serial()),
            full_scale=frame.full_scale,
            bayer=sensor.bayer,
            gain_e_per_count=sensor.gain_e_per_count,
        )
        level = float(np.median(frame.image[::8, ::8])) - sensor.black_level
        self._exposures.report(stars, sky_fraction=level / frame.full_scale)
        if self._images and self._night_of(frame.time) != self._night_of(self._images[-1].time):
            self.finish()  # the sun did not come back meanwhile: a polar night, or a clock that was set
        halo = star_halo(frame.image, stars, full_scale=frame.full_scale, bayer=sensor.bayer)
        if better(self._picture, n_stars=len(stars)):
            self._picture = night_picture(frame.image, frame.time, len(stars))
        taken = _Image(time=frame.time, exposure_us=frame.exposure_us, gain_db=frame.gain_db, stars=stars, halo=halo)
        self._images = [*self._images, taken]
        self._images = self._images[-_MOST_IMAGES:]

    def _is_repeated(self, frame: Frame) -> bool:
        """Return whether a frame is the one before once more, to the last count: no sensor's noise does that."""
        digest = zlib.crc32(frame.image.tobytes())
        repeated, self._digest = digest == self._digest, digest
        self._repeated += int(repeated)
        return repeated

    def _camera_serial(self) -> str:
        """Return the camera's serial number, as it was at the first image: another camera needs a restart."""
        if self._serial is None:
            record = self._camera.record()
            self._serial = "" if record is None else record.serial
        return self._serial

    def _report(self, found: Finding) -> None:
        self._camera.add_event(found, MESSAGES, time=self._now(), severity="warning")

    def look_at_moon(self, frames: Sequence[Frame]) -> None:
        """Keep the brightest places of a slot's short exposures until the night is over."""
        self._moon.add(frames)

    def finish(self, heartbeat: Callable[[], None] = lambda: None) -> NightVerdict:
        """Name the stars of the night, store them and the verdict; ask for a refit after one that showed them."""
        self._warm.save()
        images, self._images = self._images, []
        picture, self._picture = self._picture, None
        repeated, self._repeated = self._repeated, 0
        frozen = (Finding("night_frozen", {"n": repeated}),) if repeated else ()
        night = self._night_of(images[0].time)
        calibration = self._camera.current_model()
        if calibration is None or not self._trusted():
            kept = self._keep(picture, None, calibration)
            code = "night_without_calibration" if calibration is None else "night_clock_not_trusted"
            self._moon.forget()
            return self._remember(night, "unusable", (Finding(code),), {"n_images": len(images)}, kept)
        views = []
        for image in images:
            views.append(self._view(image, calibration))
            heartbeat()
        matched = match_views(views)
        heartbeat()
        summary = summary_of(views, matched)
        taken = [
            TakenImage(view, found, image.exposure_us / 1e6 * 10.0 ** (image.gain_db / 20.0), image.halo)
            for image, view, found in zip(images, views, matched, strict=True)
        ]
        measured = numbers_of(taken)
        kept = self._keep(picture, dict(zip([image.time for image in images], taken, strict=True)), calibration)
        offset = offset_of(views, matched, calibration)
        stored = self._store(images, views, matched)
        moon = self._moon.finish(calibration, within_px=BENT_PX, clock_error_s=self._clock_error_s)
        heartbeat()
        stored_moon = self._camera.archive.add_sun_points(moon.points)
        verdict, findings = decide_night(summary, moonlit_share=self._moonlit_share(images))
        refused = [found.matches.findings[0] for found in matched if not found.matches.accepted]
        numbers: dict[str, float] = {
            **asdict(summary),
            **measured.of_night,
            "n_stored": stored,
            "star_offset_px": offset.largest_px,
            "n_moon_images": moon.images,
            "n_moon_stored": stored_moon,
            "n_warm_pixels": len(self._warm),
        }
        if verdict in _WORTH_A_REFIT and stored >= _ENOUGH_STARS:
            self._request_refit(f"after the night of {night} ({verdict})")
        reasons = (*findings, *refused[:1], *moon.refused[:1], *frozen)
        parts: dict[str, object] = {"zenith_bands": measured.bands, "images": measured.images}
        return self._remember(night, verdict, reasons, numbers, kept | parts)

    def _keep(
        self, picture: NightPicture | None, taken: dict[datetime, TakenImage] | None, calibration: Calibration | None
    ) -> dict[str, object]:
        """Write the picture of the night, with the names of what is in it where a calibration predicts that.

        Returns
        -------
        What the event says of it: when it was taken; nothing where there is none.
        """
        if self._store_images is None or picture is None:
            return {}
        one = None if taken is None else taken.get(picture.time)
        current, record = self._camera.current_calibration(), self._camera.record()
        written = store_picture(
            self._store_images,
            picture,
            [] if one is None or calibration is None else named_bodies(one, calibration, self._camera),
            calibration=None if current is None else current.id,
            image_size=None if record is None else record.image_size,
        )
        return {"picture_time": rfc3339(picture.time)} if written else {}

    def _night_of(self, time: datetime) -> date:
        """Return the solar date of the evening that a night began with."""
        return solar_date(time.timestamp() - 0.5 * DAY_S, longitude=self._camera.site.longitude)

    def _view(self, image: _Image, calibration: Calibration) -> StarView:
        stars, site = self._warm.without_warm(image.stars), self._camera.site_at(image.time)
        return star_view(stars, image.time.timestamp(), site=site, calibration=calibration)

    def _store(
        self,
        images: Sequence[_Image],
        views: Sequence[StarView],
        matched: Sequence[MatchedView],
    ) -> int:
        """Store the sightings of accepted images and return how many were new: none of an image that was not.

        Where they replace former ones, those of an image that is not accepted any more stay.
        """
        points = [
            point
            for image, view, found in zip(images, views, matched, strict=True)
            if found.matches.accepted
            for point in self._points(image, view, found)
        ]
        if self._replaces:
            return self._camera.archive.replace_stars(self._camera.name, points)
        return self._camera.archive.add_sun_points(points)

    def _points(self, image: _Image, view: StarView, found: MatchedView) -> list[SunPoint]:
        """Return the surest stars of each part of an image as sightings."""
        record = self._camera.record()
        names, stars = surest_named(view, found, (0, 0) if record is None else record.image_size)
        epoch = self._camera.archive.epoch_at(self._camera.name, image.time, reason="first sighting")
        return [
            SunPoint(
                camera=self._camera.name,
                pose_epoch=epoch.id,
                time=image.time,
                body=str(names[row]),
                method="star",
                accepted=True,
                verdict="clear",
                reason=text_of(found.matches.findings[0]),
                exposure_us=image.exposure_us,
                x_px=float(stars.pixels[row, 0]),
                y_px=float(stars.pixels[row, 1]),
                sigma_px=float(stars.sigma_px[row]),
                peak_fraction=float(stars.peak_fraction[row]),
                ellipticity=float(stars.ellipticity[row]),
                snr=float(stars.snr[row]),
                saturated_px=0,
                clock_error_s=self._clock_error_s(image.time),
            )
            for row in range(len(stars))
        ]

    def _moonlit_share(self, images: Sequence[_Image]) -> float:
        moons = [wanderer_place("moon", image.time.timestamp(), self._camera.site) for image in images]
        return sum(moon.direction[2] > 0.0 and moon.lit > _HALF_LIT for moon in moons) / len(moons)

    def _remember(
        self,
        night: date,
        verdict: NightVerdict,
        findings: tuple[Finding, ...],
        numbers: dict[str, float],
        parts: dict[str, object],
    ) -> NightVerdict:
        """Store the verdict as an event, and set the conditions that the last nights give rise to."""
        known = {key: value for key, value in numbers.items() if math.isfinite(value)}
        why = "; ".join(map(text_of, findings))
        found = Finding("night", {"date": f"{night}", "verdict": verdict, "reasons": why, **known})
        details = {"findings": [finding.as_json() for finding in findings], **parts}
        self._camera.add_event(found, MESSAGES, time=self._now(), severity="info", details=details)
        _log.info("%s", text_of(found))
        self.publish_conditions()
        return verdict

    def publish_conditions(self) -> None:
        """Set or clear the conditions of the last nights, as the archive has them."""
        nights = [event.details for event in self._camera.nights(limit=NIGHTS_COMPARED)]
        for code, reason in night_conditions(nights, self._limits).items():
            self._board.set_condition(code, reason)
