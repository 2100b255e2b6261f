"""A calibration in a notebook: fitted, read, asked, drawn and written."""

from __future__ import annotations

import copy
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from sunarc.calibration.answers.cloud_positions import HIGHEST_CLOUD_M, cloud_positions
from sunarc.calibration.answers.direction_table import Lookup, back_projection_map, lookup
from sunarc.calibration.answers.error_model import Ensemble, draw_ensemble
from sunarc.calibration.answers.residuals import Residuals, compute_residuals
from sunarc.calibration.model.result import Calibration as Solved
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.extras import extra_module
from sunarc.common.json_text import json_text
from sunarc.formats.exported import Table
from sunarc.formats.tables import calibration_table, map_table
from sunarc.formats.view import Comparison, View
from sunarc.formats.view import compare as compared
from sunarc.geolocation.locate import Located, shadows
from sunarc.optics.camera import inside_image
from sunarc.public.calibration_files import read_view_file, write_exports
from sunarc.public.inputs import Asked, Times, Values, asked, named_as_in_python, number, one_time
from sunarc.public.stated_fit import StatedStart
from sunarc.public.summary import calibration_text, summarize_verdict
from sunarc.public.values import (
    CloudPositions,
    Directions,
    PixelPositions,
    Sightings,
    Site,
    StrPath,
    notebook_site,
)
from sunarc.sky.directions import angles_from_direction, direction_from_angles, unit_vectors
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

_REFUSED_REMEDY = "see print(calibration); or ask with accept_refused=True"


class Calibration:
    """Camera with its uncertainty and verdict: made by `sunarc.calibrate` or `sunarc.load`.

    `print(calibration)` prints what the command `sunarc calibrate` prints. A calibration that is refused answers
    nothing unless it is asked with `accept_refused=True`. One that was loaded from another program's format states no
    verdict and no uncertainty: its sigmas are NaN.

    Examples
    --------
    >>> import sunarc
    >>> calibration = sunarc.load("calibration.json")
    >>> calibration
    <sunarc.Calibration sun: accepted, equisolid, 1-sigma 0.039° over the sky>
    >>> look = calibration.back_project([400, 900], 880)
    >>> look.zenith_deg.round(1), look.inside
    (array([46.5,  3.6]), array([ True,  True]))
    """

    def __init__(
        self,
        view: View,
        *,
        document: dict[str, Any] | None = None,
        solved: Solved | None = None,
        sightings: Sightings | None = None,
        name: str = "camera",
    ) -> None:
        self.view, self._document, self._solved = view, document, solved
        self._sightings, self._name = sightings, name

    # What it is.

    @property
    def verdict(self) -> str:
        """`accepted`, `provisional`, `marginal` or `refused`; `unstated` of another program's format."""
        return "unstated" if self._document is None else summarize_verdict(self._document)

    @property
    def accepted(self) -> bool:
        """True for an accepted verdict, and for a provisional one whose 1-sigma is small."""
        return self.verdict in {"accepted", "provisional"}

    @property
    def reasons(self) -> tuple[str, ...]:
        """The findings behind the verdict, as sentences."""
        return () if self._solved is None else self._solved.verdict.reasons

    @property
    def document(self) -> dict[str, Any]:
        """A copy of the calibration document (docs/formats.md), all numbers of the calibration by their names."""
        return copy.deepcopy(self._require_document("a document"))

    @property
    def format(self) -> str:
        """Format that it is from: `json` is a calibration document."""
        return self.view.form

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.view.width, self.view.height

    @property
    def site(self) -> Site | None:
        """Site of the camera; None where its format states none."""
        return None if self._solved is None else notebook_site(self._solved.site)

    def __str__(self) -> str:
        if self._document is None:
            return f"{self._name}: {self.format}, {self.view.width}x{self.view.height} px, no uncertainty stated"
        return calibration_text(self._document)

    def __repr__(self) -> str:
        if self._solved is None:
            return f"<sunarc.Calibration {self._name}: {self.format}>"
        sigma = f"1-sigma {self._solved.sky_rms_deg:.2g}° over the sky"
        return f"<sunarc.Calibration {self._name}: {self.verdict}, {self._solved.camera.projection}, {sigma}>"

    # What it answers.

    def back_project(self, x_px: Values, y_px: Values, *, accept_refused: bool = False) -> Directions:
        """Return the directions of pixels, with their uncertainty; as `/v1/back-project` and `sunarc unproject` do.

        Parameters
        ----------
        x_px, y_px : numbers, arrays or DataArrays, broadcast against each other; (0, 0) is the centre of the top-left
            pixel, x right, y down.
        accept_refused : whether a refused calibration answers.

        Raises
        ------
        InputError
            Where the calibration is refused, a pixel is not finite, or the shapes do not fit.

        Examples
        --------
        >>> import sunarc
        >>> look = sunarc.load("calibration.json").back_project(400.0, 880.0)
        >>> print(f"{look.zenith_deg:.2f} {look.azimuth_deg:.2f} {look.sigma_deg:.3f}")
        46.49 219.39 0.015
        """
        self._require_answers(accept_refused=accept_refused)
        pixels = asked(x_px=x_px, y_px=y_px)
        if self._solved is None:
            rows = _view_rows(self.view, pixels.rows)
        else:
            rows = np.asarray(self._make_lookup.back_project(np.ascontiguousarray(pixels.rows)), dtype=np.float64)
        return Directions(
            zenith_deg=pixels.answer(rows[:, 0]),
            azimuth_deg=pixels.answer(rows[:, 1]),
            enu=pixels.answer(rows[:, 2:5], "component"),
            sigma_deg=pixels.answer(rows[:, 5]),
            inside=pixels.answer(rows[:, 6] == 1.0),
        )

    def project(self, *, zenith_deg: Values, azimuth_deg: Values, accept_refused: bool = False) -> PixelPositions:
        """Return the pixels of directions, with their uncertainty; as `/v1/project` and `sunarc project` do.

        Parameters
        ----------
        zenith_deg, azimuth_deg : apparent zenith angles, and azimuths clockwise from north; numbers, arrays or
            DataArrays, broadcast against each other.
        accept_refused : whether a refused calibration answers.

        Raises
        ------
        InputError
            Where the calibration is refused, an angle is not finite, or the shapes do not fit.

        Examples
        --------
        >>> import sunarc
        >>> seen = sunarc.load("calibration.json").project(zenith_deg=30.0, azimuth_deg=200.0)
        >>> print(f"{seen.x_px:.1f} {seen.y_px:.1f} {seen.inside}")
        586.1 788.8 True
        """
        self._require_answers(accept_refused=accept_refused)
        angles = asked(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
        directions = _make_directions(angles)
        if self._solved is None:
            pixels = self.view.project(directions)
            rows = np.column_stack([pixels, np.full((len(pixels), 4), np.nan), _is_in_image(self.view, pixels)])
        else:
            rows = np.asarray(self._make_lookup.project(directions), dtype=np.float64)
        return PixelPositions(
            x_px=angles.answer(rows[:, 0]),
            y_px=angles.answer(rows[:, 1]),
            sigma_px=angles.answer(rows[:, 2]),
            covariance_px2=angles.answer(rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2), "component", "component_too"),
            inside=angles.answer(rows[:, 6] == 1.0),
        )

    def geolocate(
        self,
        x_px: Values,
        y_px: Values,
        *,
        cloud_height_m: Values,
        cloud_height_sigma_m: float = 0.0,
        time: Times | None = None,
        accept_refused: bool = False,
    ) -> CloudPositions:
        """Return the positions of the clouds that pixels see; as `/v1/geolocate` does.

        Parameters
        ----------
        x_px, y_px : pixels.
        cloud_height_m : of the cloud base above the camera's altitude, above 0 and at most 30 000 m.
        cloud_height_sigma_m : its 1-sigma.
        time : one time, of whose sun the shadows are; without it there are no shadows.
        accept_refused : whether a refused calibration answers.

        Raises
        ------
        InputError
            Where the calibration is refused or states no uncertainty, or a height is out of bounds.

        Examples
        --------
        >>> import sunarc
        >>> cloud = sunarc.load("calibration.json").geolocate(400.0, 880.0, cloud_height_m=1500)
        >>> print(f"{cloud.east_m:.0f} {cloud.north_m:.0f} {cloud.latitude:.4f} {cloud.longitude:.4f}")
        -1003 -1221 36.5930 -97.4961
        """
        self._require_answers(accept_refused=accept_refused)
        solved = self._require_solved("positions of clouds")
        points = asked(x_px=x_px, y_px=y_px, cloud_height_m=cloud_height_m)
        height_m = points.rows[:, 2]
        if not np.all((height_m > 0.0) & (height_m <= HIGHEST_CLOUD_M)):
            problem = f"is not above 0 and at most {HIGHEST_CLOUD_M:g} m"
            raise InputError(field="cloud_height_m", problem=problem, remedy="give the height of a cloud base in m")
        sigma_m = number(cloud_height_sigma_m, field="cloud_height_sigma_m")
        pixels, site = np.ascontiguousarray(points.rows[:, :2]), solved.site
        cloud = cloud_positions(self._make_lookup, pixels, height_m=height_m, height_sigma_m=sigma_m, site=site)
        shadow = None
        if time is not None:
            unix_s = one_time(time, remedy="give one time")
            with np.errstate(all="ignore"):  # a cloud without a place has no shadow
                shadow = _make_cloud_positions(points, shadows(cloud, sun_directions(unix_s, site), site))
        return _make_cloud_positions(points, cloud, shadow)

    def draw(self, draws: int, *, seed: int, accept_refused: bool = False) -> Draws:
        """Return possible truths: joint draws of the errors of lens, pose and field, as `?draws=` does.

        Parameters
        ----------
        draws : how many, 1 to 1000.
        seed : from 0; with the calibration's id it decides the draws.
        accept_refused : whether a refused calibration answers.

        Examples
        --------
        >>> import sunarc
        >>> draws = sunarc.load("calibration.json").draw(100, seed=1)
        >>> drawn = draws.back_project(400.0, 880.0)
        >>> drawn.zenith_deg.shape, bool(drawn.zenith_deg.std() < 0.1)
        ((100,), True)
        """
        self._require_answers(accept_refused=accept_refused)
        solved = self._require_solved("draws")
        for name, value, least, most in (("draws", draws, 1, _MOST_DRAWS), ("seed", seed, 0, 2**63)):
            given = number(value, field=name)
            if given != int(given) or not least <= given <= most:
                remedy = f"give a whole number from {least}" + (f" to {most}" if name == "draws" else "")
                raise InputError(field=name, problem=f"{value!r} is out of bounds", remedy=remedy)
        named = str(self._require_document("draws")["id"])
        ensemble = draw_ensemble(solved, draws=int(draws), seed=int(seed), calibration_id=named)
        return Draws(ensemble)

    # What it is drawn as.

    def plot_residuals(self, sightings: Sightings | None = None, *, ax: Axes | None = None) -> Axes:
        """Draw the residuals of the sightings over the image, x right and y down as in the picture.

        Parameters
        ----------
        sightings : those to draw; those of the fit unless given. A calibration that was loaded has none.
        ax : axes to draw into; new ones unless given.

        Examples
        --------
        >>> import sunarc
        >>> ax = sunarc.load("calibration.json").plot_residuals(sunarc.read_sightings("sun.csv"))
        >>> ax.get_xlabel()
        'x (px)'
        """
        plots, solved = _import_plots(), self._require_solved("a plot of residuals")
        residuals = self._compute_residuals(solved, sightings)
        if residuals is None:
            raise InputError(
                field="sightings", problem="missing: a loaded calibration has none", remedy="give them to plot"
            )
        drawn: Axes = plots.draw_arrows(plots.axes_or_new(ax), solved.camera, residuals)
        return drawn

    def plot_uncertainty(self, *, ax: Axes | None = None) -> Axes:
        """Draw the 1-sigma of the pixels' directions over the image, x right and y down as in the picture.

        Parameters
        ----------
        ax : axes to draw into; new ones unless given.

        Examples
        --------
        >>> import sunarc
        >>> ax = sunarc.load("calibration.json").plot_uncertainty()
        >>> ax.get_ylim()
        (np.float64(1747.5), np.float64(-0.5))
        """
        plots, solved = _import_plots(), self._require_solved("a plot of uncertainty")
        drawn: Axes = plots.draw_uncertainty(plots.axes_or_new(ax), solved, self._make_lookup)
        return drawn

    def plot_sky(self, sightings: Sightings | None = None, *, ax: Axes | None = None) -> Axes:
        """Draw the 1-sigma over the sky, zenith in the middle, turned so that north and east are as in the picture.

        Parameters
        ----------
        sightings : whose directions are drawn; those of the fit unless given.
        ax : polar axes to draw into; new ones unless given.

        Examples
        --------
        >>> import sunarc
        >>> sunarc.load("calibration.json").plot_sky().name
        'polar'
        """
        plots, solved = _import_plots(), self._require_solved("a plot of the sky")
        if ax is not None and ax.name != "polar":
            remedy = "make them with plt.subplot(projection='polar')"
            raise InputError(field="ax", problem="are not polar", remedy=remedy)
        polar = plots.axes_or_new(ax, projection="polar")
        drawn: Axes = plots.draw_sky(polar, solved, self._compute_residuals(solved, sightings))
        return drawn

    # What it is written as.

    def to_xarray(self, *, every_pixel: bool = False) -> xarray.Dataset:
        """Return directions and 1-sigma on a grid of pixels as a Dataset, with units (CF conventions).

        Parameters
        ----------
        every_pixel : whether every pixel is in it, in single precision; every eighth one unless set, with the
            parameters and their covariance.

        Examples
        --------
        >>> import sunarc
        >>> found = sunarc.load("calibration.json").to_xarray()
        >>> found.zenith.dims, found.sigma.units
        (('y', 'x'), 'degree')
        """
        solved, document = self._require_solved("arrays"), self._require_document("arrays")
        if every_pixel:
            return _make_dataset(map_table(back_projection_map(self._make_lookup), document, masks={}))
        return _make_dataset(calibration_table(solved, document)[0])

    def save(self, path: StrPath) -> None:
        """Write the calibration document, which `sunarc.load` and all commands read.

        Examples
        --------
        >>> import sunarc, tempfile, pathlib
        >>> target = pathlib.Path(tempfile.mkdtemp()) / "calibration.json"
        >>> calibration = sunarc.load("calibration.json")
        >>> calibration.save(target)
        >>> sunarc.load(target).document == calibration.document
        True
        """
        document, path = self._require_document("a document to save"), Path(path)
        with disk_errors(path):
            path.write_text(json_text(document), encoding="utf-8")

    def export(self, format: str, path: StrPath, *, accept_refused: bool = False) -> str:  # noqa: A002 - its name
        """Write the calibration in another format, as `sunarc export` does; return how far the format is from it.

        Parameters
        ----------
        format : `opencv`, `mrcal`, `ocamcalib`, `asi-core`, `netcdf`, `colmap`, `ros`, `fits`, … (docs/formats.md).
        path : file to write; of `asi-core` and `azimuth-zenith-…` a folder.
        accept_refused : whether a refused calibration is written.

        Examples
        --------
        >>> import sunarc, tempfile, pathlib
        >>> target = pathlib.Path(tempfile.mkdtemp()) / "camera.yml"
        >>> sunarc.load("calibration.json").export("opencv", target)[:28]
        'differs from the calibration'
        >>> sunarc.load(target).format
        'opencv'
        """
        self._require_answers(accept_refused=accept_refused)
        with named_as_in_python():
            (one,) = write_exports([self._require_document("a calibration to export")], format, Path(path))
        return one.error

    # Internal.

    @cached_property
    def _make_lookup(self) -> Lookup:
        return lookup(self._require_solved("uncertainty"))

    def require_usable(self) -> Solved:
        """Return the calibration as the library has it, where it answers; internal."""
        self._require_answers(accept_refused=False)
        return self._require_solved("uncertainty")

    def as_start(self) -> StatedStart:
        """Return the camera as one to begin a fit at; internal."""
        return StatedStart(self._name, self.view, self._solved)

    def _compute_residuals(self, solved: Solved, sightings: Sightings | None) -> Residuals | None:
        """Return the residuals of sightings, or of those of the fit; None without sightings."""
        given = self._sightings if sightings is None else sightings
        return None if given is None else compute_residuals(solved, given.at(notebook_site(solved.site)))

    def _require_solved(self, wanted: str) -> Solved:
        return self._refuse_format(wanted) if self._solved is None else self._solved

    def _require_document(self, wanted: str) -> dict[str, Any]:
        return self._refuse_format(wanted) if self._document is None else self._document

    def _refuse_format(self, wanted: str) -> NoReturn:
        problem = f"{self._name} is of the format {self.format}, which gives no {wanted.removeprefix('a ')}"
        raise InputError(
            field="calibration", problem=problem, remedy="fit it: sunarc.calibrate(..., start=calibration)"
        )

    def _require_answers(self, *, accept_refused: bool) -> None:
        """Raise InputError where a calibration is refused and was not asked for, or has no pose."""
        if not self.view.has_pose:
            problem = f"{self._name} has no pose: its directions are of the camera's own frame"
            remedy = "fit it: sunarc.calibrate(..., start=calibration, pose_only=True)"
            raise InputError(field="calibration", problem=problem, remedy=remedy)
        if not (accept_refused or self.accepted or self.verdict == "unstated"):
            problem = f"is {self.verdict}: {self.reasons[0]}"
            raise InputError(field="calibration", problem=problem, remedy=_REFUSED_REMEDY)


_MOST_DRAWS = 1000


class Draws:
    """Draws from a calibration's uncertainty: evaluate each, and take the spread.

    Examples
    --------
    >>> import sunarc
    >>> len(sunarc.load("calibration.json").draw(16, seed=1))
    16
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self._ensemble = ensemble

    def __len__(self) -> int:
        return len(self._ensemble)

    def back_project(self, x_px: Values, y_px: Values) -> Directions:
        """Return the directions of pixels by each draw, the first axis; without sigma.

        Examples
        --------
        >>> import sunarc
        >>> draws = sunarc.load("calibration.json").draw(16, seed=1)
        >>> draws.back_project([400, 800], [880, 880]).azimuth_deg.shape
        (16, 2)
        """
        pixels = asked(x_px=x_px, y_px=y_px)
        rows = np.stack([self._ensemble.back_project(draw, pixels.rows) for draw in self._ensemble])
        zenith, azimuth = angles_from_direction(rows)
        return Directions(
            zenith_deg=pixels.answer(zenith, before=_BY_DRAW),
            azimuth_deg=pixels.answer(azimuth, before=_BY_DRAW),
            enu=pixels.answer(rows, "component", before=_BY_DRAW),
            sigma_deg=None,
            inside=pixels.answer(np.all(np.isfinite(rows), axis=-1), before=_BY_DRAW),
        )

    def project(self, *, zenith_deg: Values, azimuth_deg: Values) -> PixelPositions:
        """Return the pixels of directions by each draw, the first axis; without sigma.

        Examples
        --------
        >>> import sunarc
        >>> draws = sunarc.load("calibration.json").draw(16, seed=1)
        >>> draws.project(zenith_deg=30.0, azimuth_deg=200.0).x_px.shape
        (16,)
        """
        angles = asked(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
        directions = _make_directions(angles)
        rows = np.stack([self._ensemble.project(draw, directions) for draw in self._ensemble])
        return PixelPositions(
            x_px=angles.answer(rows[..., 0], before=_BY_DRAW),
            y_px=angles.answer(rows[..., 1], before=_BY_DRAW),
            sigma_px=None,
            covariance_px2=None,
            inside=angles.answer(np.all(np.isfinite(rows), axis=-1), before=_BY_DRAW),
        )


_BY_DRAW = ("draw",)


def load(path: StrPath) -> Calibration:
    """Return the calibration of a file: a calibration document, or any other format that is read (docs/formats.md).

    Raises
    ------
    InputError
        Where the file cannot be read, or its format is unknown.

    Examples
    --------
    >>> import sunarc
    >>> sunarc.load("calibration.json").image_size
    (1748, 1748)
    """
    path = Path(path)
    view = read_view_file(path)
    document = view.document
    name = path.name if document is None else str(document["camera"])
    return Calibration(view, document=document, solved=view.calibration, name=name)


def compare(first: Calibration | StrPath, second: Calibration | StrPath) -> Comparison:
    """Return the differences of a second camera from a first one over the sky, as `sunarc compare` does.

    Parameters
    ----------
    first, second : calibrations, or files of any format that is read.

    Raises
    ------
    InputError
        Where the images are of different sizes, or nothing of the sky is in both.

    Examples
    --------
    >>> import sunarc
    >>> found = sunarc.compare("calibration.json", sunarc.load("calibration.json"))
    >>> found.total.max_px < 1e-6, found.rotation_deg < 1e-6
    (True, True)
    """
    one, other = (each if isinstance(each, Calibration) else load(each) for each in (first, second))
    return compared(one.view, other.view)


def _make_directions(angles: Asked) -> FloatArray:
    """Return the unit vectors (n, 3) of zenith angles and azimuths."""
    return unit_vectors(direction_from_angles(zenith_deg=angles.rows[:, 0], azimuth_deg=angles.rows[:, 1]))


def _view_rows(view: View, pixels: FloatArray) -> FloatArray:
    """Return (n, 7) as `Lookup.back_project` does, of a camera that states no uncertainty."""
    directions = view.unproject(pixels)
    angles = np.stack(angles_from_direction(directions), axis=-1)
    inside = _is_in_image(view, pixels) * np.isfinite(directions[:, 0])
    return np.column_stack([angles, directions, np.full(len(pixels), np.nan), inside])


def _is_in_image(view: View, pixels: FloatArray) -> FloatArray:
    """Return (n,): 1 of the pixels (n, 2) within the image, else 0."""
    return inside_image(pixels, (view.width, view.height)).astype(np.float64)


def _make_cloud_positions(points: Asked, found: Located, shadow: CloudPositions | None = None) -> CloudPositions:
    east, north, up = found.position_m.T
    return CloudPositions(
        east_m=points.answer(east),
        north_m=points.answer(north),
        up_m=points.answer(up),
        latitude=points.answer(np.where(np.isnan(east), np.nan, found.geodetic.latitude)),
        longitude=points.answer(np.where(np.isnan(east), np.nan, found.geodetic.longitude)),
        altitude_m=points.answer(np.where(np.isnan(east), np.nan, found.geodetic.altitude)),
        sigma_m=points.answer(found.sigma_m),
        covariance_m2=points.answer(found.covariance_m2[:, :2, :2], "component", "component_too"),
        shadow=shadow,
    )


def _import_plots() -> Any:  # noqa: ANN401 - a module of an extra
    """Return the module that draws; InputError names the extra that it needs."""
    extra_module("matplotlib", extra="plots")
    from sunarc.public import plots  # noqa: PLC0415 - matplotlib is of an extra

    return plots


def _make_dataset(table: Table) -> xarray.Dataset:
    """Return a table as a Dataset."""
    made = extra_module("xarray", extra="xarray")
    arrays = {name: (one.dimensions, one.values, dict(one.attributes)) for name, one in table.variables.items()}
    found: xarray.Dataset = made.Dataset(arrays, attrs=dict(table.attributes))
    return found
