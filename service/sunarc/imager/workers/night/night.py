"""The worker of the night: finds the stars in its images, names them when it is over, and stores them as sightings."""

from __future__ import annotations

import logging
import math
import threading
import zlib
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field, fields, replace
from datetime import date, datetime, timedelta
from pathlib import Path

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S, rfc3339
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.photometry import NightLimits, NightTrend, dew_suspected, focus_ratio, star_halo
from sunarc.detection.stars.warm_pixels import WarmPixelMap
from sunarc.detection.values import FWHM, Stars
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.obstructions import ObstructionLearner
from sunarc.imager.archive.values import Event, Night, NightVerdict, Refit, SunPoint, unusable_night
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import turns
from sunarc.imager.runtime.status import Reason, StatusRegistry, condition
from sunarc.imager.workers.night.exposures import NightCapture
from sunarc.imager.workers.night.images import (
    FrameNote,
    KeptImages,
    KeptMoon,
    KeptStars,
    NightPicture,
    WarmPixelFile,
    better,
    named_bodies,
    night_picture,
    store_picture,
)
from sunarc.imager.workers.night.moon import MoonImages
from sunarc.imager.workers.night.named_stars import (
    MOST_BRIGHTER_MAG,
    TakenImage,
    cloud_fraction,
    estimate_limit,
    exposed_longer,
    measure_radial_offset,
    night_numbers,
    seen_and_missed,
)
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.sky.days import solar_date
from sunarc.sky.night import body_position
from sunarc.sky.sun import DARK_ZENITH_DEG
from sunarc.stars.views import BENT_PX, MatchedView, StarView, match_views, matching_flip, star_view, surest_named

# What a night was like, by its images.

_FEWEST_IMAGES = 3
_CLEAR_SHARE, _CLEAR_CLOUDS = 0.8, 0.25
_PARTLY_SHARE = 0.1
_MOONLIT_SHARE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class NightSummary:
    """The numbers of a night; NaN where no image was matched.

    Attributes
    ----------
    n_images, n_accepted : images, and those whose stars were named.
    n_stars, n_matched : detections and named stars of an accepted image, medians.
    limiting_magnitude : V to which half of the stars are detected, the median of the accepted images.
    star_fwhm_px : width of the stars, the median of all images.
    cloud_fraction : share of the stars to V 4 that are not seen, the mean of the images: 1 in those not accepted.
    """

    n_images: int
    n_accepted: int
    n_stars: int
    n_matched: int
    limiting_magnitude: float
    star_fwhm_px: float
    cloud_fraction: float


_MOST_FLIPPED = 4
"""Images, those with most detections, in which flips are looked for where no image's stars match."""


def _find_flip(
    views: Sequence[StarView], matched: Sequence[MatchedView], calibration: Calibration
) -> tuple[Finding, ...]:
    """Return the finding of images that are stored otherwise than those of the calibration."""
    lit = sorted((view for view in views if len(view.stars)), key=lambda view: -len(view.stars))[:_MOST_FLIPPED]
    if not lit or any(found.matches.accepted for found in matched):
        return ()
    flip, counts = matching_flip(lit, (calibration.camera.width, calibration.camera.height))
    return (Finding("stars_flipped", {"flip": flip, "n": max(counts)}),) if any(counts) else ()


def _exposure_finding(by_image: dict[int, float]) -> tuple[Finding, ...]:
    """Return the finding of images whose stars are too bright for the stated exposure; empty without such images."""
    data = {"n": len(by_image), "magnitudes": max(by_image.values(), default=0.0), "limit": MOST_BRIGHTER_MAG}
    return (Finding("night_exposed_longer", data),) if by_image else ()


def summarize_night(views: Sequence[StarView], matched: Sequence[MatchedView]) -> NightSummary:
    """Return the numbers of a night of images and their matches."""
    pairs = [(view, found) for view, found in zip(views, matched, strict=True) if found.matches.accepted]
    widths = np.concatenate([view.stars.width_px for view in views]) if views else np.zeros(0)
    clouds = [1.0] * (len(views) - len(pairs)) + [cloud_fraction(view) for view, _ in pairs]
    return NightSummary(
        n_images=len(views),
        n_accepted=len(pairs),
        n_stars=round(_finite_median([len(found.stars) for _, found in pairs], otherwise=0.0)),
        n_matched=round(_finite_median([found.matches.star.size for _, found in pairs], otherwise=0.0)),
        limiting_magnitude=_finite_median([estimate_limit(view) for view, _ in pairs]),
        star_fwhm_px=FWHM * _finite_median(widths.tolist()),
        cloud_fraction=float(np.mean(clouds)) if clouds else math.nan,
    )


def decide_night(summary: NightSummary, *, moonlit_share: float) -> tuple[NightVerdict, tuple[Finding, ...]]:
    """Return the verdict of a night, with its findings.

    Parameters
    ----------
    summary : its numbers.
    moonlit_share : of its images, those with a moon above the horizon that is more than half lit.
    """
    share = summary.n_accepted / max(summary.n_images, 1)
    counts = {"n": summary.n_accepted, "images": summary.n_images}
    if summary.n_images < _FEWEST_IMAGES:
        return "unusable", (Finding("night_few_images", {"n": summary.n_images, "limit": _FEWEST_IMAGES}),)
    found = (Finding("night_images", {**counts, "cloud_fraction": summary.cloud_fraction}),)
    if share >= _CLEAR_SHARE and summary.cloud_fraction <= _CLEAR_CLOUDS:
        return "clear", found
    if share >= _PARTLY_SHARE:
        return "partly", found
    return ("moonlit" if moonlit_share > _MOONLIT_SHARE else "cloudy"), found


def _finite_median(values: Sequence[float], *, otherwise: float = math.nan) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else otherwise


_log = logging.getLogger(__name__)

_POLL_S = 0.5
_MOST_IMAGES = 200
_WORTH_A_REFIT: frozenset[NightVerdict] = frozenset({"clear", "partly"})
_ENOUGH_STARS = 50
_HALF_LIT = 0.5
_MOST_TRIES = 5
"""Verdicts of one night that may be begun: images that end the process each time would otherwise do so for ever."""
_DAYLIGHT, _DAYLIGHT_DISTRUSTED = timedelta(minutes=1), timedelta(hours=1)
"""How long the sun must have been back before the night is over; the longer one while the clock is not trusted: a
clock that was set for seconds or minutes shows a sun that is not there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _StarImage:
    """An image of the night, without its pixels."""

    time: datetime
    exposure_us: float
    gain_db: float
    stars: Stars
    halo: float
    clock_error_s: float


@dataclass(eq=False)
class NightWorker:
    """Detects the stars in each image of the night; when the sun is back, names them and stores the verdict.

    The calibration that is served then predicts the stars of the whole night: on the first night of a camera there is
    none before midnight. With `resumes` what was measured in each image is in the archive until the verdict is.

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
    resumes : whether a restart goes on with the night's images.
    obstructions : learns from the stars; those behind obstructions are not expected.
    """

    capture: NightCapture
    _: KW_ONLY
    camera: CameraArchive
    options: SensorOptions
    apparent_zenith: Callable[[], float]
    clock_error_s: Callable[[datetime], float]
    trusted: Callable[[], bool]
    now: Callable[[], datetime]
    request_refit: Callable[[str], Refit]
    board: StatusRegistry
    limits: NightLimits = field(default_factory=NightLimits)
    store: ImageStore | None = None
    warm_pixels: Path | None = None
    replaces: bool = False
    resumes: bool = False
    obstructions: ObstructionLearner | None = None

    def __post_init__(self) -> None:
        """Begin without images."""
        self._kept = KeptImages(self.camera) if self.resumes else None
        self._daylight_since: datetime | None = None
        self._images: list[_StarImage] = []
        self._picture: NightPicture | None = None
        self._warm = WarmPixelMap(
            None if self.warm_pixels is None else WarmPixelFile(self.warm_pixels, self._write_event)
        )
        self._serial: str | None = None
        self._digest: int | None = None
        self._repeated = 0
        exposures = None if self.capture.moon is None else self.capture.moon.exposures
        self._moon = MoonImages(self.camera, options=self.options, exposures=exposures)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped."""
        self.resume()
        self.publish_conditions()
        for _ in turns(stop, heartbeat):
            frame = self.capture.frames.get(timeout_s=_POLL_S)
            moon = None if self.capture.moon is None else self.capture.moon.frames.get(timeout_s=0.0)
            if moon is not None:
                self.add_moon_exposures(moon)
            if frame is not None:
                self.look_at(frame)
            elif self._images and self._is_over():
                self.finish(heartbeat)

    def resume(self) -> None:
        """Read the images of a night without a verdict from the archive; those of one night alone."""
        if self._kept is None:
            return
        stars, moons = self._kept.read()
        if stars:
            night, last = self._evening_date(stars[-1].note.frame.time), stars[-1].note
            stars = [one for one in stars if self._evening_date(one.note.frame.time) == night]
            moons = [one for one in moons if self._evening_date(one.note.frame.time) == night]
            self._images = [_as_star_image(one) for one in stars][-_MOST_IMAGES:]
            self._digest, self._repeated = last.digest, stars[-1].n_repeated
            self._picture = next((_as_night_picture(one) for one in reversed(stars) if one.picture is not None), None)
            alike = [one for one in stars if one.note.sensor == last.sensor]
            self._warm.resume(last.sensor, ((one.note.frame.time, one.outstanding) for one in alike))
            _log.info("the night of %s goes on with %d images from before the start", night, len(self._images))
        for one in moons:
            self._moon.resume(one.note.frame, one.cutouts, clock_error_s=one.note.clock_error_s)

    def _is_over(self) -> bool:
        """Return whether the sun is up, for longer than a clock that was set for a moment would show."""
        if self.apparent_zenith() >= DARK_ZENITH_DEG:
            self._daylight_since = None
            return False
        now = self.now()
        if self._daylight_since is None or now < self._daylight_since:
            self._daylight_since = now
        return now - self._daylight_since >= (_DAYLIGHT if self.trusted() else _DAYLIGHT_DISTRUSTED)

    def look_at(self, frame: Frame) -> None:
        """Detect the stars of a frame, and keep them, unless the clock that dates it was just set."""
        if self._is_repeated(frame):
            return
        clock_error_s = self.clock_error_s(frame.time)
        if self._images and self._evening_date(frame.time) != self._evening_date(self._images[-1].time):
            if clock_error_s > MAX_CLOCK_ERROR_S:
                return
            self._begin_new_night()
        sensor = frame_sensor(frame, self.options)
        stars = detect_stars(
            self._warm.repair(frame, sensor.bayer, serial=self._camera_serial()),
            full_scale=frame.full_scale,
            bayer=sensor.bayer,
            gain_e_per_count=sensor.gain_e_per_count,
        )
        level = float(np.median(frame.image[::8, ::8])) - sensor.black_level
        self.capture.exposures.report(stars, sky_fraction=level / frame.full_scale)
        halo = star_halo(frame.image, stars, full_scale=frame.full_scale, bayer=sensor.bayer)
        shown = None
        if better(self._picture, n_stars=len(stars)):
            shown = self._picture = night_picture(frame.image, frame.time, len(stars))
        kept = KeptStars(
            FrameNote(frame, clock_error_s, self._digest or 0, self._camera_serial()),
            stars,
            halo,
            self._warm.newest,
            self._repeated,
            None if shown is None else shown.jpeg,
        )
        self._images = [*self._images, _as_star_image(kept)][-_MOST_IMAGES:]
        if self._kept is not None:
            self._kept.keep(kept, since=min(image.time for image in self._images))

    def _begin_new_night(self) -> None:
        """Begin a new night although the sun was not up between: polar night, or wrong times of the first images."""
        if all(image.clock_error_s > MAX_CLOCK_ERROR_S for image in self._images):
            _log.warning("%d images of the night that no good clock dated are left out", len(self._images))
            self._forget_images()
            if self._kept is not None:
                self.camera.archive.nights.drop_images(self.camera.name)
        else:
            self.finish()

    def _forget_images(self) -> None:
        self._images, self._picture, self._repeated, self._daylight_since = [], None, 0, None
        self._moon.forget()

    def _is_repeated(self, frame: Frame) -> bool:
        """Return whether a frame is the one before once more, to the last count: no sensor's noise does that."""
        digest = zlib.crc32(frame.image.tobytes())
        repeated, self._digest = digest == self._digest, digest
        self._repeated += int(repeated)
        return repeated

    def _camera_serial(self) -> str:
        """Return the camera's serial number, as it was at the first image: another camera needs a restart."""
        if self._serial is None:
            record = self.camera.archive.cameras.get(self.camera.name)
            self._serial = "" if record is None else record.serial
        return self._serial

    def _write_event(self, found: Finding) -> None:
        self.camera.add_event(found, time=self.now(), severity="warning")

    def add_moon_exposures(self, frames: Sequence[Frame]) -> None:
        """Keep the brightest cutouts of a slot's short exposures, in which the moon may be, until the night is over."""
        frame, cutouts = self._moon.add(frames)
        if self._kept is not None:
            note = FrameNote(frame, self.clock_error_s(frame.time))
            self._kept.keep(KeptMoon(note, cutouts), since=frame.time - timedelta(days=1))

    def finish(self, heartbeat: Callable[[], None] = lambda: None) -> Night:
        """Name the stars of the night, store them and the verdict; ask for a refit after one that showed them."""
        self._warm.save()
        tries = 1 if self._kept is None else self.camera.archive.nights.begin_verdict(self.camera.name)
        if tries > _MOST_TRIES:
            found = Finding("night_given_up", {"n": len(self._images), "tries": _MOST_TRIES})
            night = self._make_unusable_night(self._images, (found,), None)
        else:
            night = self._judge_night(heartbeat, again=tries > 1)
        self._store_night(night)
        self._forget_images()
        return night

    def _judge_night(self, heartbeat: Callable[[], None], *, again: bool) -> Night:
        """Do the work of `finish` with the present images; `again` where it was begun before a restart."""
        images, picture = self._images, self._picture
        frozen = (Finding("night_frozen", {"n": self._repeated}),) if self._repeated else ()
        calibration = self.camera.archive.calibrations.current_model(self.camera.name)
        if calibration is None or not self.trusted():
            code = "night_without_calibration" if calibration is None else "night_clock_not_trusted"
            return self._make_unusable_night(images, (Finding(code),), self._keep_picture(picture, None, calibration))
        images, taken, longer = self._name_stars(images, calibration, heartbeat)
        views, matched = [one.view for one in taken], [one.found for one in taken]
        summary = summarize_night(views, matched)
        measured = night_numbers(taken)
        picture_time = self._keep_picture(
            picture, dict(zip([image.time for image in images], taken, strict=True)), calibration
        )
        offset = measure_radial_offset(views, matched, calibration)
        stored = self._store_sightings(images, views, matched, again=again)
        moon = self._moon.finish(calibration, within_px=BENT_PX, clock_error_s=self.clock_error_s)
        heartbeat()
        stored_moon = max(self.camera.archive.sightings.add(moon.points), len(moon.points) if again else 0)
        verdict, findings = decide_night(summary, moonlit_share=self._moonlit_share(images))
        refused = [found.matches.findings[0] for found in matched if not found.matches.accepted]
        flipped = _find_flip(views, matched, calibration)
        evening = self._evening_date(images[0].time)
        if verdict in _WORTH_A_REFIT and stored >= _ENOUGH_STARS:
            self.request_refit(f"after the night of {evening} ({verdict})")
        air, trend = measured.air, measured.trend
        return Night(
            camera=self.camera.name,
            date=evening,
            verdict=verdict,
            findings=(*findings, *refused[:1], *flipped, *moon.refused[:1], *frozen, *longer),
            decided_at=self.now(),
            n_images=summary.n_images,
            n_accepted=summary.n_accepted,
            n_stored=stored,
            n_moon_images=moon.images,
            n_moon_stored=stored_moon,
            n_warm_pixels=len(self._warm),
            n_stars=summary.n_stars,
            n_matched=summary.n_matched,
            star_offset_px=_known_number(offset.largest_px),
            limiting_magnitude=_known_number(summary.limiting_magnitude),
            star_fwhm_px=_known_number(summary.star_fwhm_px),
            cloud_fraction=_known_number(summary.cloud_fraction),
            transparency=_known_number(10.0 ** (-0.4 * air.per_air_mass)),
            extinction=_known_number(air.per_air_mass),
            extinction_sigma=_known_number(air.sigma),
            zero_point=_known_number(_finite_median(air.zero_point.tolist())),
            star_ellipticity=_known_number(measured.star_ellipticity),
            halo=_known_number(measured.halo),
            width_growth=_known_number(trend.width_growth),
            halo_growth=_known_number(trend.halo_growth),
            fading_mag=_known_number(trend.fading_mag),
            zenith_bands=measured.bands,
            images=measured.images,
            picture_time=picture_time,
        )

    def _zero_points_before(self) -> list[float]:
        """Return the zero points of the last nights that showed stars."""
        nights = self.camera.archive.nights.find(self.camera.name, limit=NIGHTS_COMPARED)
        return [one.zero_point for one in nights if one.verdict in _WORTH_COMPARING and one.zero_point is not None]

    def _name_stars(
        self, images: Sequence[_StarImage], calibration: Calibration, heartbeat: Callable[[], None]
    ) -> tuple[list[_StarImage], list[TakenImage], tuple[Finding, ...]]:
        """Return images with the stars that the calibration names, without those that were exposed for longer."""
        views = []
        for image in images:
            views.append(self._make_view(image, calibration))
            heartbeat()
        matched = match_views(views)
        if self.obstructions is not None:
            self.obstructions.take_stars(*seen_and_missed(views, matched))
        heartbeat()
        taken = [
            TakenImage(view, found, image.exposure_us / 1e6 * 10.0 ** (image.gain_db / 20.0), image.halo)
            for image, view, found in zip(images, views, matched, strict=True)
        ]
        longer = exposed_longer(taken, self._zero_points_before())
        kept = [row for row in range(len(taken)) if row not in longer]
        return [images[row] for row in kept], [taken[row] for row in kept], _exposure_finding(longer)

    def _make_unusable_night(
        self, images: Sequence[_StarImage], findings: tuple[Finding, ...], picture_time: datetime | None
    ) -> Night:
        """Return the verdict of a night whose images show nothing of the sky."""
        evening, now = self._evening_date(images[0].time), self.now()
        night = unusable_night(self.camera.name, evening, findings=findings, decided_at=now, n_images=len(images))
        return replace(night, picture_time=picture_time)

    def _keep_picture(
        self, picture: NightPicture | None, taken: dict[datetime, TakenImage] | None, calibration: Calibration | None
    ) -> datetime | None:
        """Write the picture of the night, with the names of its bodies where a calibration predicts them.

        Returns
        -------
        When it was taken; None without a picture.
        """
        if self.store is None or picture is None:
            return None
        one = None if taken is None else taken.get(picture.time)
        current = self.camera.archive.calibrations.current(self.camera.name)
        record = self.camera.archive.cameras.get(self.camera.name)
        written = store_picture(
            self.store,
            picture,
            [] if one is None or calibration is None else named_bodies(one, calibration, self.camera),
            calibration=None if current is None else current.id,
            image_size=None if record is None else record.image_size,
        )
        return picture.time if written else None

    def _evening_date(self, time: datetime) -> date:
        """Return the solar date of the evening that a night began with."""
        return solar_date(time.timestamp() - 0.5 * DAY_S, longitude=self.camera.site.longitude)

    def _make_view(self, image: _StarImage, calibration: Calibration) -> StarView:
        stars, site = self._warm.without_warm(image.stars), self.camera.site_with_air_at(image.time)
        view = star_view(stars, image.time.timestamp(), site=site, calibration=calibration)
        if self.obstructions is None:
            return view
        hidden = self.obstructions.hides(view.predicted_directions)
        return replace(view, predicted=view.predicted.select(~hidden))

    def _store_sightings(
        self,
        images: Sequence[_StarImage],
        views: Sequence[StarView],
        matched: Sequence[MatchedView],
        *,
        again: bool,
    ) -> int:
        """Store the sightings of accepted images and return how many were new: none of an image that was not.

        Where they replace former ones, those of an image that is not accepted any more stay. `again`: some may be there
        already, of the same verdict, and count as new.
        """
        points = [
            point
            for image, view, found in zip(images, views, matched, strict=True)
            if found.matches.accepted
            for point in self._make_sightings(image, view, found)
        ]
        if self.replaces or again:
            new = self.camera.archive.sightings.replace_stars(self.camera.name, points)
            return len(points) if again else new
        return self.camera.archive.sightings.add(points)

    def _make_sightings(self, image: _StarImage, view: StarView, found: MatchedView) -> list[SunPoint]:
        """Return the surest stars of each part of an image as sightings."""
        record = self.camera.archive.cameras.get(self.camera.name)
        names, stars = surest_named(view, found, (0, 0) if record is None else record.image_size)
        return [
            SunPoint(
                camera=self.camera.name,
                pose_epoch="",
                time=image.time,
                body=str(names[row]),
                method="star",
                accepted=True,
                verdict="clear",
                findings=found.matches.findings[:1],
                exposure_us=image.exposure_us,
                x_px=float(stars.pixels[row, 0]),
                y_px=float(stars.pixels[row, 1]),
                sigma_px=float(stars.sigma_px[row]),
                peak_fraction=float(stars.peak_fraction[row]),
                ellipticity=float(stars.ellipticity[row]),
                snr=float(stars.snr[row]),
                saturated_px=0,
                clock_error_s=max(self.clock_error_s(image.time), image.clock_error_s),
            )
            for row in range(len(stars))
        ]

    def _moonlit_share(self, images: Sequence[_StarImage]) -> float:
        moons = [body_position("moon", image.time.timestamp(), self.camera.site) for image in images]
        return sum(moon.direction[2] > 0.0 and moon.illuminated_fraction > _HALF_LIT for moon in moons) / len(moons)

    def _store_night(self, night: Night) -> None:
        """Store the verdict, and set the conditions that the last nights give rise to."""
        event = night_event(night)
        self.camera.archive.nights.save(night, event=event, drops_images=self._kept is not None)
        _log.info("%s", event.text)
        self.publish_conditions()

    def publish_conditions(self) -> None:
        """Set or clear the conditions of the last nights, as the archive has them."""
        nights = self.camera.archive.nights.find(self.camera.name, limit=NIGHTS_COMPARED)
        for code, reason in night_conditions(nights, self.limits).items():
            self.board.set_condition(code, reason)


def night_event(night: Night) -> Event:
    """Return the event of a night: its verdict, its numbers as far as they are known, and why."""
    values = {one.name: getattr(night, one.name) for one in fields(night)}
    numbers = {name: value for name, value in values.items() if isinstance(value, int | float)}
    parts: dict[str, object] = {"findings": [finding.as_json() for finding in night.findings]}
    if night.images is None:
        numbers = {"n_images": night.n_images}
    else:
        times = [time.isoformat(timespec="seconds") for time in night.images.time]
        parts |= {"zenith_bands": [asdict(band) for band in night.zenith_bands]}
        parts |= {"images": asdict(night.images) | {"time": times}}
    if night.picture_time is not None:
        parts["picture_time"] = rfc3339(night.picture_time)
    why = "; ".join(one.text for one in night.findings)
    found = Finding("night", {"date": f"{night.date}", "verdict": night.verdict, "reasons": why, **numbers})
    return Event.of(found, time=night.decided_at, severity="info", camera=night.camera, details=parts)


def _known_number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _as_star_image(kept: KeptStars) -> _StarImage:
    frame = kept.note.frame
    return _StarImage(
        time=frame.time,
        exposure_us=frame.exposure_us,
        gain_db=frame.gain_db,
        stars=kept.stars,
        halo=kept.halo,
        clock_error_s=kept.note.clock_error_s,
    )


def _as_night_picture(kept: KeptStars) -> NightPicture:
    return NightPicture(time=kept.note.frame.time, n_stars=len(kept.stars), jpeg=kept.picture or b"")


# Conditions that the numbers of the last nights give rise to: stars that grew wide, a dome that dewed over.

NIGHT_CODES = ("night_focus_worse", "night_dew_suspected")
NIGHTS_COMPARED = 20
_WORTH_COMPARING = frozenset({"clear", "partly"})


def night_conditions(nights: Sequence[Night], limits: NightLimits) -> dict[str, Reason | None]:
    """Return the conditions by code, None for one that does not hold.

    Parameters
    ----------
    nights : the last ones, the newest first.
    limits : what is suspected.
    """
    return dict(zip(NIGHT_CODES, (_focus_condition(nights, limits), _dew_condition(nights, limits)), strict=True))


def _focus_condition(nights: Sequence[Night], limits: NightLimits) -> Reason | None:
    """Return the condition of stars that are wider than they were."""
    widths = [
        night.star_fwhm_px for night in nights if night.verdict in _WORTH_COMPARING and night.star_fwhm_px is not None
    ]
    ratio = focus_ratio(widths, limits)
    if ratio is None:
        return None
    return condition("night_focus_worse", ratio=ratio, fwhm_px=widths[0], nights=limits.nights)


def _dew_condition(nights: Sequence[Night], limits: NightLimits) -> Reason | None:
    """Return the condition of a last night whose stars faded while they grew wider or hazy."""
    if not nights:
        return None
    newest = nights[0]
    numbers = (newest.width_growth, newest.halo_growth, newest.fading_mag)
    width, halo, fading = (math.nan if number is None else number for number in numbers)
    if not dew_suspected(NightTrend(width_growth=width, halo_growth=halo, fading_mag=fading), limits):
        return None
    return condition(
        "night_dew_suspected", date=f"{newest.date}", width_growth=width, halo_growth=halo, fading_mag=fading
    )
