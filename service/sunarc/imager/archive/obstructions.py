"""Obstructions that the images of a camera have shown: sums in one file, the mask and the horizon they make."""

from __future__ import annotations

import io
import json
import logging
import math
import threading
import zipfile
from dataclasses import fields, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S, MICROSECOND, utc_time
from sunarc.detection.values import Detection
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.images import write_atomically
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imaging.horizon import HorizonProfile, find_obstructions
from sunarc.imaging.obstructions import (
    UNKNOWN,
    CellGrid,
    Change,
    ObstructionMask,
    ObstructionSums,
    States,
    add_star_votes,
    carried_over,
    carried_states,
    cell_grid,
    mask_changes,
    no_sums,
    updated_sums,
)
from sunarc.sky.sun import sun_directions

_log = logging.getLogger(__name__)
_EVERY_S = 300.0
"""Between images that are used; they share votes of ten minutes."""
_MASK_EVERY_S = 6.0 * 3600.0
"""Between masks, and between writes of the sums."""
_BEFORE_FIRST = timedelta(days=3)
"""Before the first mask: how far back suns are held to it, those that its images have shown."""
_SAME_DEG = 0.2
"""Turn of the camera below which its cells show the same directions, about half a cell."""


class LearnedObstructions(NamedTuple):
    """The mask and the horizon of the last six hours' sums, and the calibration they are of."""

    calibration: str
    pose_epoch: str
    time: datetime
    mask: ObstructionMask
    horizon: HorizonProfile

    @property
    def hidden_share(self) -> float:
        """Share of the sky that is hidden, dirt on the dome with it."""
        area = self.mask.grid.area_deg2
        return float(area[self.mask.hidden_cells].sum() / area.sum())


class ObstructionLearner:
    """Learns the obstructions of a camera from its images; any thread may ask for the mask.

    Parameters
    ----------
    camera : its archive and site.
    path : the file of the sums; where it is lost or damaged, learning begins anew.
    """

    def __init__(self, camera: CameraArchive, path: Path) -> None:
        self._camera, self._path, self._lock = camera, path, threading.Lock()
        self._sums: ObstructionSums | None = None
        self._grid: CellGrid | None = None
        self._model: Calibration | None = None
        self._calibration, self._pose_epoch = "", ""
        self._learned: LearnedObstructions | None = None
        self._known: _KnownStates | None = None
        self._written_s = -math.inf

    @property
    def learned(self) -> LearnedObstructions | None:
        """Mask that is served; None before there was a clear day."""
        return self._learned

    @property
    def missing(self) -> str:
        """Return the reason why there is no mask yet, as a sentence."""
        if self._sums is None:
            return "no image has been compared with a calibration yet"
        return f"too little sunshine was seen: {self._sums.missing_h:.1f} h more are needed"

    def hides(self, directions: FloatArray) -> BoolArray:
        """Return (n,): which directions (n, 3), east-north-up, are behind an obstruction; none without a mask."""
        found = self._learned
        return np.zeros(directions.shape[:-1], dtype=bool) if found is None else found.mask.hides(directions)

    def hides_sun(self, unix_s: FloatArray) -> BoolArray:
        """Return (n,): at which times, s since 1970, the sun is behind an obstruction."""
        return self.hides(sun_directions(unix_s, self._camera.site))

    def checked(self, detection: Detection, time: datetime) -> Detection:
        """Return a detection, rejected where the sun was behind an obstruction: it is a reflection or a gap's light."""
        counts = detection.accepted or detection.verdict == ELSEWHERE
        if not counts or not self.hides_sun(np.array([time.timestamp()]))[0]:
            return detection
        return replace(detection, accepted=False, verdict="obstructed", findings=(Finding("sun_behind_obstruction"),))

    def take_stars(self, named: FloatArray, missed: FloatArray) -> None:
        """Use the stars of a night, see `add_star_votes`."""
        with self._lock:
            if self._sums is not None and self._grid is not None:
                self._sums = add_star_votes(self._sums, self._grid, named=named, missed=missed)

    def take(self, image: Image, time: datetime) -> None:
        """Use an image, unless one of the last minutes was used; images that cannot be used or written are left out."""
        unix_s = time.timestamp()
        with self._lock:
            if self._sums is not None and 0.0 <= unix_s - self._sums.unix_s < _EVERY_S:
                return
            try:
                self._use_image(image, time)
            except (InputError, OutsideError, OSError) as error:
                _log.warning("an image could not be used for the obstruction mask: %s", error)

    def _use_image(self, image: Image, time: datetime) -> None:
        archive = self._camera.archive.calibrations
        record = archive.current(self._camera.name)
        if record is None:
            return
        if record.id != self._calibration:
            self._follow_calibration(record.id, archive.model(record.id))
            self._pose_epoch = record.pose_epoch or ""
        if self._sums is None or self._grid is None or self._model is None:
            return
        sun = np.asarray(sun_directions(time.timestamp(), self._camera.site))
        self._sums = updated_sums(self._sums, image, self._grid, sun=sun, unix_s=time.timestamp())
        if abs(time.timestamp() - self._written_s) >= _MASK_EVERY_S or (self._learned is None and self._sums.is_ready):
            self._renew_mask(time)

    def _follow_calibration(self, calibration: str, model: Calibration) -> None:
        """Take a new calibration; after a turn of the camera the evidence is carried over by directions."""
        grid = cell_grid(model.camera)
        sums = self._sums
        if sums is None:
            calibration_before, sums, self._known = _read_sums(self._path)
            before = self._find_known(calibration_before)
        else:
            before = self._model
        if sums is None or before is None or sums.log_odds.shape != grid.shape:
            sums, self._known = no_sums(grid), None
        elif _turn_deg(before, model) > _SAME_DEG:
            sums, self._learned = carried_over(sums, before.camera, grid), None
            if self._known is not None:
                states, seen = (carried_states(one, before.camera, grid) for one in self._known[:2])
                self._known = _KnownStates(states, seen, self._known.unix_s)
        self._sums, self._grid, self._model, self._calibration = sums, grid, model, calibration

    def _find_known(self, calibration: str) -> Calibration | None:
        try:
            return self._camera.archive.calibrations.model(calibration) if calibration else None
        except InputError:
            return None

    def _renew_mask(self, time: datetime) -> None:
        """Make the mask anew, store the sums, and write the events of its changes."""
        sums, grid, model = self._sums, self._grid, self._model
        if sums is None or grid is None or model is None:
            return
        self._written_s = time.timestamp()
        if sums.is_ready:
            is_first = self._learned is None
            mask, horizon = find_obstructions(sums, grid, sigma_deg=model.sky_rms_deg)
            self._learned = LearnedObstructions(self._calibration, self._pose_epoch, time, mask, horizon)
            if is_first:
                self._set_aside_before(time)
            self._compare(mask, time)
        write_atomically(self._path, _encode_sums(self._calibration, sums, self._known))

    def _compare(self, mask: ObstructionMask, time: datetime) -> None:
        """Write the events of changes that this mask and one of a day before show: a move is found within a day."""
        known = self._known or _KnownStates(mask.state, mask.state, time.timestamp())
        if abs(time.timestamp() - known.unix_s) >= DAY_S:
            lasting = np.where(mask.state == known.seen, mask.state, np.uint8(UNKNOWN))
            changes, states = mask_changes(known.states, replace(mask, state=lasting))
            for change in changes:
                self._camera.add_event(_change_finding(change), time=time, severity="info")
            known = _KnownStates(states, mask.state, time.timestamp())
        self._known = known

    def _set_aside_before(self, time: datetime) -> None:
        """Leave the suns behind obstructions out of every fit that were accepted before the first mask."""
        sightings, name = self._camera.archive.sightings, self._camera.name
        times = sightings.columns(name, since=time - _BEFORE_FIRST, until=time).unix_s
        for unix_s in times[self.hides_sun(times)].tolist():
            at = utc_time(unix_s)
            sightings.exclude(name, Finding("sun_behind_obstruction"), since=at, until=at + MICROSECOND)


class _KnownStates(NamedTuple):
    """States of cells that are known, those of the mask that was last compared with them, and its time."""

    states: States
    seen: States
    unix_s: float


def _change_finding(change: Change) -> Finding:
    data = {name: round(value, 1) for name, value in change._asdict().items() if name != "appeared"}
    return Finding("obstruction_appeared", data) if change.appeared else Finding("obstruction_gone", data)


def _turn_deg(before: Calibration, after: Calibration) -> float:
    """Return the largest angle between the directions of two calibrations' corners and centre."""
    from sunarc.optics.inverse_table import inverse_table  # noqa: PLC0415 - only after a change

    width, height = after.camera.width, after.camera.height
    at = np.array([[x * width, y * height] for x in (0.3, 0.5, 0.7) for y in (0.3, 0.5, 0.7)])
    one, other = (inverse_table(model.camera).directions(at) for model in (before, after))
    cosine = np.clip(np.nansum(one * other, axis=-1), -1.0, 1.0)
    return float(np.degrees(np.arccos(np.min(cosine))))


_ARRAYS = ("log_odds", "texture", "contrast", "last")


def _encode_sums(calibration: str, sums: ObstructionSums, known: _KnownStates | None) -> bytes:
    plain = {one.name: getattr(sums, one.name) for one in fields(sums) if one.name not in _ARRAYS}
    plain["counts"] = dict(sums.counts)
    arrays = {name: getattr(sums, name).astype(np.float16) for name in _ARRAYS}
    if known is not None:
        plain["known_s"], arrays["known"] = known.unix_s, np.stack(known[:2])
    text = json.dumps({"calibration": calibration, **plain})
    content = io.BytesIO()
    np.savez_compressed(content, plain=np.array(text), **arrays)
    return content.getvalue()


def _read_sums(path: Path) -> tuple[str, ObstructionSums | None, _KnownStates | None]:
    """Return the calibration, the sums and the known states of a file; None without a sound one."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            plain: dict[str, Any] = json.loads(str(stored["plain"]))
            arrays = {name: stored[name].astype(np.float32) for name in _ARRAYS}
            pair = stored.get("known")
        known = None if pair is None else _KnownStates(pair[0], pair[1], float(plain.pop("known_s")))
        calibration = str(plain.pop("calibration"))
        sums = replace(ObstructionSums(**arrays), **plain)
        whole = sums.log_odds.shape == sums.texture.shape == sums.contrast.shape
        if whole and all(np.isfinite(one).all() for one in arrays.values()):
            return calibration, sums, known if known and known.states.shape == sums.log_odds.shape else None
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        _log.warning("the sums of the obstruction mask are damaged, and begin anew: %s", error)
    return "", None, None
