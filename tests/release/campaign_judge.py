"""Judges what a campaign left behind against the simulator's truth, and keeps watch while it runs."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
import urllib.request
from dataclasses import dataclass, field
from http.client import HTTPException
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.formats.calibration_document import from_document
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions
from sunarc.sources.expected_sun import SEARCHED

_EARTH_RATE_DEG_S = 15.041 / 3600.0
_SIGMAS = 6.0
"""An accepted sighting farther off than this many of its own sigmas is wrong."""
_SLACK_PX = 0.05
"""Beside the sigmas: the simulated disc, the PSF and the low sun's refraction are not modelled to better."""
_STAR_SLACK_PX = 1.5
"""Beside the sigmas of a star: its coma; a wrong name is farther off."""
_SKY_FACTOR = 3.0
"""RMS error over the sky, in units of the stated RMS, from which a calibration is served worse than stated."""
_SKY_FLOOR_DEG = 0.002
_SILENT_SLOTS = 10
"""Slots of clear sun without a sighting, in which /readyz must give a reason."""
_GRACE_S = 3.0
"""Real seconds for which /readyz may still say "ready" then: the service looks every second, on a busy host later."""
CLEAR_ZENITH_DEG = 78.0
_GAPS = 0.05
_LONGEST_LOOK_SLOTS = 30
"""Time that goes on by more between two looks has jumped over a night, or another imager has begun."""
_CALIBRATED_AFTER_DAYS = 2.0
"""From the first sighting to the last, after which a calibration is due."""


@dataclass(kw_only=True)
class Findings:
    """What was found wrong; empty lists and zeros are what is wanted.

    Attributes
    ----------
    lost, doubled : sightings that were stored once and are gone; times and exposures stored twice.
    forgotten : images of a folder that were handed on whole and have no sighting; rows that the hub has not as the
        imager has them.
    wrong_sightings : accepted ones farther from the truth than they state.
    worse_than_stated : served calibrations with a larger error over the sky than stated.
    silent : times at which /readyz was "ready" while no sighting had been stored for 10 slots of clear sun,
        whatever fault is being done.
    copies : accepted sightings in a repeated image whose first delivery was never evaluated (the service was down, or
        too busy); nothing in the image shows that it is a copy, so up to one in each of those faults is no fault.
    gaps : accepted sightings of pictures that were searched before there was a calibration, farther from the truth
        than they state: a round gap in cloud cannot be told from the sun then. One in twenty is no fault: a fit leaves
        them out.
    own_exits : exit codes of the service's unexpected exits.
    served : every calibration that was served, its true and its stated error.
    not_calibrated : why a calibration was due and none was served; empty where that is not so.
    left_out : faults that cannot be done here.
    wrong_stars : stars that are named and are elsewhere.
    flipped : kinds of files in which a bit was flipped.
    installations : times that an operator had to accept another installation at the hub.
    nights : how many of each verdict.
    days : from the first sighting to the last.
    not_recovered : what did not go on by itself after the faults of a window, within minutes.
    n_starts, n_starts_again : of the service; those after an end with a reason at the start (a full disk).
    worst : the largest error of a served calibration over what it states.
    """

    n_sightings: int = 0
    n_accepted: int = 0
    n_served: int = 0
    n_repeating: int = 0
    n_searched: int = 0
    n_stars: int = 0
    n_of_hub: int = 0
    installations: int = 0
    lost: list[str] = field(default_factory=list)
    forgotten: list[str] = field(default_factory=list)
    doubled: list[str] = field(default_factory=list)
    wrong_sightings: list[str] = field(default_factory=list)
    worse_than_stated: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)
    own_exits: list[str] = field(default_factory=list)
    copies: list[str] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    served: list[str] = field(default_factory=list)
    n_starts: int = 0
    n_starts_again: int = 0
    not_recovered: list[str] = field(default_factory=list)
    nights: dict[str, int] = field(default_factory=dict)
    days: float = 0.0
    worst: float = 0.0
    left_out: list[str] = field(default_factory=list)
    wrong_stars: list[str] = field(default_factory=list)
    flipped: list[str] = field(default_factory=list)
    not_calibrated: str = ""
    integrity: str = ""

    @property
    def wrong(self) -> list[str]:
        """What was found wrong; empty where nothing was."""
        names = ("lost", "forgotten", "doubled", "wrong_sightings", "worse_than_stated", "silent", "wrong_stars")
        found = [f"{name} {text}" for name in (*names, "own_exits", "not_recovered") for text in getattr(self, name)]
        found += ["too many copies"] * (len(self.copies) > self.n_repeating)
        found += ["too many gaps"] * (len(self.gaps) > _GAPS * self.n_searched)
        found += [self.not_calibrated] if self.not_calibrated else []
        return found + ([] if self.integrity == "ok" else [f"integrity {self.integrity}"])

    @property
    def good(self) -> bool:
        """Whether nothing was found wrong."""
        return not self.wrong


class Judge:
    """Looks again and again, and once at the end.

    Parameters
    ----------
    database, port : of the service.
    truth : the document of the true camera.
    site : where it stands.
    cadence_s : of the slots, simulated seconds.
    """

    def __init__(self, database: Path, port: int, *, truth: dict[str, Any], site: Site, cadence_s: float) -> None:
        self._database = database
        self._url = f"http://127.0.0.1:{port}"
        self._truth = from_document(truth).camera
        self._site = site
        self._cadence_s = cadence_s
        self._stored: set[tuple[int, float]] = set()
        self._served: dict[str, dict[str, Any]] = {}
        self._sunny_since: float | None = None
        self._last_look: float | None = None
        self._ready_since_s: float | None = None
        self._repeated: list[tuple[float, float]] = []
        self._errors: dict[str, tuple[float, float]] = {}
        self.found = Findings()

    def look(self, simulated_unix_s: float | None) -> None:
        """Note what is stored and served now.

        Parameters
        ----------
        simulated_unix_s : the imager's time; None while it is not known.
        """
        stored = self.stored()
        if stored is not None:
            self.found.lost += [f"{time / 1e6:.3f} {exposure:g}" for time, exposure in sorted(self._stored - stored)]
            self._stored = stored
        served = self._get("/v1/calibration")
        if served is not None:
            self._served[served["id"]] = served
        self._look_for_silence(simulated_unix_s)

    def _look_for_silence(self, moment: float | None) -> None:
        last, self._last_look = self._last_look, moment
        jumped = moment is None or last is None or not 0.0 <= moment - last <= _LONGEST_LOOK_SLOTS * self._cadence_s
        if moment is None or jumped or self._zenith_deg(moment) > CLEAR_ZENITH_DEG:
            self._sunny_since = self._ready_since_s = None
            return
        self._sunny_since = moment if self._sunny_since is None else self._sunny_since
        newest = max((time for time, _ in self._stored), default=0) / 1e6
        late_s = moment - max(newest, self._sunny_since)
        answer = self._get("/readyz") if late_s > _SILENT_SLOTS * self._cadence_s else None
        if answer is None or answer["status"] != "ready":
            self._ready_since_s = None
            return
        real_s = time.monotonic()
        self._ready_since_s = real_s if self._ready_since_s is None else self._ready_since_s
        if real_s - self._ready_since_s > _GRACE_S:
            self.found.silent.append(f"{moment:.0f}: nothing stored for {late_s:.0f} s")

    def _zenith_deg(self, moment: float) -> float:
        return float(sun_angles(moment, self._site).apparent_zenith)

    def check(self) -> Findings:
        """Judge all that is stored and all that was served until now."""
        found = self.found
        with contextlib.closing(
            sqlite3.connect(f"file:{self._database}?mode=ro", uri=True, timeout=20.0)
        ) as connection:
            found.integrity = str(connection.execute("PRAGMA integrity_check").fetchone()[0])
            rows = connection.execute(
                "SELECT time, exposure_us, accepted, x_px, y_px, sigma_px, clock_error_s, ingest_pass FROM sun_point "
                "WHERE body = 'sun' ORDER BY time"
            ).fetchall()
            stars = connection.execute("SELECT body, time, x_px, y_px, sigma_px FROM sun_point WHERE method = 'star'")
            found.n_stars, found.wrong_stars = self._stars(stars.fetchall())
            nights = connection.execute("SELECT verdict, count(*) FROM night GROUP BY verdict")
            found.nights = dict(nights.fetchall())
        keys = [(row[0], row[1]) for row in rows]
        found.doubled = [str(key) for key, other in pairwise(keys) if key == other]
        found.n_sightings = len(rows)
        self._check_sightings(np.array([row for row in rows if row[2]], dtype=np.float64).reshape(-1, 8))
        for document in self._served.values():
            if document["id"] not in self._errors:
                self._errors[document["id"]] = self._error_and_stated(document)
        found.n_served = len(self._served)
        errors = self._errors.items()
        found.served = [
            f"{one}: {error:.4f} degrees over the sky, {stated:.4f} stated" for one, (error, stated) in errors
        ]
        shares = [error / max(stated, _SKY_FLOOR_DEG) for error, stated in self._errors.values()]
        found.worst = max(shares, default=0.0)
        found.worse_than_stated = [text for text, one in zip(found.served, shares, strict=True) if one > _SKY_FACTOR]
        found.days = (rows[-1][0] - rows[0][0]) / 8.64e10 if rows else 0.0
        found.not_calibrated = ""
        if not found.served and found.days > _CALIBRATED_AFTER_DAYS:
            found.not_calibrated = f"no calibration was served in {found.days:.1f} days"
        if not rows:
            found.not_calibrated = "no sighting was stored: the host may be too slow"
        return found

    def _check_sightings(self, accepted: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        found = self.found
        found.n_accepted = len(accepted)
        searched = {float(row[0]) / 1e6 for row in accepted if row[7] == SEARCHED}
        found.n_searched = len(searched)
        found.copies, found.gaps, found.wrong_sightings = [], [], []
        for moment, text in self._wrong(accepted):
            if self._is_copy(moment):
                found.copies.append(text)
            else:
                (found.gaps if moment in searched else found.wrong_sightings).append(text)
        found.n_repeating = len(self._repeated)

    def put_back(self) -> None:
        """Note that an operator put the database back to a copy: what that has not is not lost."""
        self._stored = self.stored() or set()

    def repeated(self, begin: float, end: float, *, times: int) -> None:
        """Note that the camera repeated its images between two of its times, which may be believed so many times."""
        self._repeated += [(begin - self._cadence_s, end + self._cadence_s)] * times

    def _is_copy(self, moment: float) -> bool:
        return any(begin <= moment <= end for begin, end in self._repeated)

    def _wrong(self, rows: np.ndarray[Any, np.dtype[np.float64]]) -> list[tuple[float, str]]:
        """Return the accepted sightings that are farther from the truth than they state: times and texts."""
        times, pixels, sigma = rows[:, 0] / 1e6, rows[:, 3:5], rows[:, 5]
        clock = np.nan_to_num(rows[:, 6])
        off = np.linalg.norm(pixels - project(self._truth, sun_directions(times, self._site)), axis=-1)
        px_per_s = np.radians(_EARTH_RATE_DEG_S) * max(self._truth.focal_length_px)
        allowed = _SIGMAS * sigma * np.sqrt(2.0) + clock * px_per_s + _SLACK_PX
        return [
            (float(t), f"{t:.3f}: {o:.3f} px off, {a:.3f} allowed")
            for t, o, a in zip(times, off, allowed, strict=True)
            if o > a
        ]

    def _stars(self, rows: list[tuple[Any, ...]]) -> tuple[int, list[str]]:
        """Return how many stars are named, and those that are elsewhere."""
        if not rows:
            return 0, []
        names, times = np.array([row[0] for row in rows], dtype=np.str_), np.array([row[1] / 1e6 for row in rows])
        pixels = np.array([row[2:4] for row in rows], dtype=np.float64)
        allowed = _SIGMAS * np.array([row[4] for row in rows]) * np.sqrt(2.0) + _STAR_SLACK_PX
        off = np.linalg.norm(pixels - project(self._truth, body_directions(names, times, self._site)), axis=-1)
        wrong = [f"{names[k]} at {times[k]:.3f}: {off[k]:.2f} px off" for k in np.flatnonzero(~(off <= allowed))]
        return len(rows), wrong

    def _error_and_stated(self, document: dict[str, Any]) -> tuple[float, float]:
        """Return the RMS error over the sky of a served calibration, and the RMS that it states, degrees."""
        calibration = from_document(document)
        directions = hemisphere(600)
        pixels, _ = project_with_covariance(calibration, directions)
        off = pixels - project(self._truth, directions)
        off = off[np.all(np.isfinite(off), axis=-1)]
        error_deg = float(np.degrees(np.sqrt(np.mean(np.sum(off**2, axis=-1))) / max(self._truth.focal_length_px)))
        return error_deg, float(document["uncertainty"]["sky_rms_deg"]) * np.sqrt(2.0)

    def stored(self) -> set[tuple[int, float]] | None:
        """Return time and exposure of each sighting; None while the database cannot be read."""
        if not self._database.exists():
            return None
        try:
            with contextlib.closing(
                sqlite3.connect(f"file:{self._database}?mode=ro", uri=True, timeout=0.5)
            ) as connection:  # one that waits for the collector would keep a restore from its exclusive lock
                return set(connection.execute("SELECT time, exposure_us FROM sun_point WHERE body = 'sun'").fetchall())
        except sqlite3.OperationalError:
            return None  # locked, or not made yet

    def _get(self, route: str) -> dict[str, Any] | None:
        try:
            with urllib.request.urlopen(self._url + route, timeout=5.0) as response:
                answer: dict[str, Any] = json.load(response)
                return answer
        except (OSError, HTTPException, ValueError):
            return None
