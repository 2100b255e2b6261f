"""The command `sunarc calibrate`: parse, call, print."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, get_args

import typer

from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, Mirrored
from sunarc.calibration.stated_prior import PriorTolerances
from sunarc.cli.options import (
    SITE,
    AsJson,
    ClockError,
    Config,
    LatitudeIfGiven,
    LevelWithin,
    LongitudeIfGiven,
    MirroredOption,
    OutwardsPx,
    ProjectionOption,
    parse_angles,
    parse_image_size,
    print_json,
    print_rows,
    service_settings,
    stated_once,
)
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.extras import require_extra
from sunarc.common.json_text import json_text
from sunarc.common.messages import significant
from sunarc.formats.lens_prior import read_lens_type
from sunarc.imager.runtime.clock import SystemClock
from sunarc.optics.projections import PROJECTIONS
from sunarc.public.calibrate_files import (
    calibrate_file,
    calibrate_joint,
    combined_lens,
    parse_image_circle,
    write_lens_prior,
)
from sunarc.public.summary import calibration_text, summarize_verdict
from sunarc.sky.site import Site
from sunarc.sources.files import read_file

if TYPE_CHECKING:
    from sunarc.imager.settings.model import Settings


_PANEL = "Cameras of one type of lens"
LensPriorFile = Annotated[
    Path | None,
    typer.Option("--lens-prior", help="What is known of this type of lens, a file.", rich_help_panel=_PANEL),
]
WriteLensPrior = Annotated[
    Path | None,
    typer.Option(
        "--write-lens-prior",
        callback=act_as_folder_owner,
        help="Write what this calibration, and those of --lens-of, say of the type of lens.",
        rich_help_panel=_PANEL,
    ),
]
LensOf = Annotated[
    list[Path] | None,
    typer.Option(
        "--lens-of", help="A calibration document of another camera of the type; repeat it.", rich_help_panel=_PANEL
    ),
]
SpreadText = Annotated[
    str | None,
    typer.Option(
        "--unit-spread",
        metavar="F,C,R,D",
        help="1-sigma between units: focal length (relative), centre, radial, decentering (px).",
        rich_help_panel=_PANEL,
    ),
]
JointFile = Annotated[
    Path | None,
    typer.Option("--joint", metavar="SPEC.toml", help="Fit several cameras and epochs.", rich_help_panel=_PANEL),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        callback=act_as_folder_owner,
        help="Write the calibration here, unless it is refused: a document (JSON); of --joint the folder of all.",
    ),
]


def known_lens(path: Path | None, *, start: Path | None, writes: bool) -> LensType | None:
    """Return the type of lens of a file; None without one."""
    if path is None:
        return None
    if start is not None:
        raise InputError(field="--lens-prior", problem="beside --start", remedy="give one of them")
    if writes:
        raise InputError(
            field="--write-lens-prior",
            problem="beside --lens-prior: the fit would count what the file says once more",
            remedy="fit without --lens-prior, and name the other cameras with --lens-of",
        )
    return read_lens_type(read_file(path), name=path.name)


class LensToWrite(NamedTuple):
    """Where a lens prior is written, None: nowhere; the other cameras' documents; the stated spread between units."""

    path: Path | None
    others: list[Path]
    spread: UnitSpread | None

    def write(self, documents: list[dict[str, Any]]) -> None:
        """Write the combined lens of accepted calibrations."""
        if self.path is None or not all(document["verdict"]["accepted"] for document in documents):
            return
        lens = combined_lens(documents, self.others, spread=self.spread)
        write_lens_prior(self.path, lens)
        typer.echo(f"lens prior of {len(lens.cameras)} cameras: {self.path}", err=True)


def parse_spread(text: str | None) -> UnitSpread | None:
    """Return the spread between units that F,C,R,D states."""
    if text is None:
        return None
    try:
        focal, center, radial, decentering = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            field="--unit-spread", problem=f"{text!r}", remedy="give four numbers, as 0.003,8,0.4,0.3"
        ) from None
    return UnitSpread(focal_length=focal, center_px=center, radial_px=radial, decentering_px=decentering)


def print_joint(spec: Path, folder: Path | None, *, as_json: bool) -> None:
    """Fit the entries of a file, and print one row an entry; exit 1 where one is refused."""
    if folder is None:
        raise InputError(field="--output", problem="missing beside --joint", remedy="name a folder")
    documents = calibrate_joint(spec, folder=folder, now=SystemClock().now())
    rows = [
        [
            document["camera"],
            document["pose_epoch"],
            "accepted" if document["verdict"]["accepted"] else "refused",
            f"{significant(document['uncertainty']['sky_rms_deg'], 2)}°",
            document["verdict"]["reasons"][-1 if document["verdict"]["accepted"] else 0],
        ]
        for document in documents
    ]
    print_rows(documents, ("camera", "epoch", "verdict", "1-sigma over the sky", ""), rows, as_json=as_json)
    if not all(document["verdict"]["accepted"] for document in documents):
        raise typer.Exit(1)


PRIOR = "A start as a prior"
Value = TypeVar("Value")


def calibrate(
    points: Annotated[
        Path | None,
        typer.Argument(
            help="Sightings: time_utc,x_px,y_px[,sigma_px][,body][,zenith_deg,azimuth_deg]"
            "[,temperature_c][,pressure_hpa][,clock_error_s].",
            show_default=False,
        ),
    ] = None,
    *,
    latitude: LatitudeIfGiven = None,
    longitude: LongitudeIfGiven = None,
    image_size: Annotated[str | None, typer.Option(help="W,H in px.")] = None,
    image_circle: Annotated[
        str | None, typer.Option(help="X,Y,RADIUS in px, or a daytime image that shows it.")
    ] = None,
    altitude: Annotated[
        float | None, typer.Option(help="Metres above sea level; 0 unless given.", rich_help_panel=SITE)
    ] = None,
    pressure: Annotated[float | None, typer.Option(help="Pa; from the altitude unless given.")] = None,
    temperature: Annotated[
        float | None, typer.Option(help="Annual mean, degrees Celsius; 12 unless given.", show_default=False)
    ] = None,
    projection: ProjectionOption = None,
    method: Annotated[str, typer.Option(help="robust or paper.")] = "robust",
    mirrored: MirroredOption = None,
    level_within: LevelWithin = None,
    clock_error: ClockError = None,
    outwards_px: OutwardsPx = None,
    start: Annotated[
        Path | None, typer.Option(help="Begin at the camera of this file: a calibration document or another format.")
    ] = None,
    pose_only: Annotated[
        bool,
        typer.Option(
            "--pose-only",
            help="Keep that camera's lens (of a format that states no uncertainty: to 1 px); fit the pose alone.",
        ),
    ] = False,
    lens_within: Annotated[
        float | None,
        typer.Option(help="Take --start as a prior: 1-sigma of its image near the horizon, px.", rich_help_panel=PRIOR),
    ] = None,
    pose_within: Annotated[
        float | None,
        typer.Option(help="1-sigma of its rotation, degrees; unknown unless given.", rich_help_panel=PRIOR),
    ] = None,
    focal_within: Annotated[
        float | None,
        typer.Option(
            help="1-sigma of its focal length, relative; by --lens-within unless given.", rich_help_panel=PRIOR
        ),
    ] = None,
    lens_prior: LensPriorFile = None,
    write_lens_prior: WriteLensPrior = None,
    lens_of: LensOf = None,
    unit_spread: SpreadText = None,
    joint: JointFile = None,
    output: Output = None,
    provisional: Annotated[
        bool,
        typer.Option(
            "--provisional", help="Keep a fit that lacks only hours or days; it answers where its 1-sigma is small."
        ),
    ] = False,
    plots: Annotated[
        Path | None, typer.Option(callback=act_as_folder_owner, help="Folder for residuals.png and sky.png.")
    ] = None,
    again: Annotated[
        str | None, typer.Option("--again", metavar="ID", help="Solve a past calibration of the archive again.")
    ] = None,
    config: Config = None,
    as_json: AsJson = False,
) -> None:
    """Fit the camera to sightings; exit 1 when the fit is refused, or --again leads to another camera.

    With --provisional a fit is kept that is refused only for what its sightings do not determine.

    Without POINTS the accepted sightings of the archive are taken, and the result is stored there: site, lens and
    limits come from the settings (--config). With POINTS, what is not given of the site comes from these settings.

    Example: sunarc calibrate points.csv --latitude 36.6 --longitude 97.5W --image-size 1748,1748 -o calibration.json
    """
    if again is not None:
        _solve_again(again, config, as_json=as_json)
        return
    if joint is not None:
        print_joint(joint, output, as_json=as_json)
        return
    to_write = LensToWrite(write_lens_prior, lens_of or [], parse_spread(unit_spread))
    if points is None and write_lens_prior is not None:
        to_write.write([])
        return
    if points is None:
        require_extra("imager", what="calibrate without POINTS")
    if points is None and config is not None:
        of_points = (latitude, longitude, image_size, image_circle, pressure, start, plots, pose_only or None, output)
        of_fit = (projection or None, mirrored or None, outwards_px)
        _require_settings_only(*of_points, *of_fit, lens_within, pose_within, focal_within, lens_prior)

        settings = stated_level(service_settings(config), level_within)
        calibrate_stored(settings, provisional=provisional, as_json=as_json, clock_error_s=clock_error)
        return
    if pose_only and start is None:
        raise InputError(field="--pose-only", problem="no lens to keep", remedy="name a calibration with --start")
    document = calibrate_file(
        _require_given(points, "POINTS"),
        site=_choose_site(config, *parse_angles(latitude, longitude), altitude, pressure, temperature),
        image_size=parse_image_size(_require_given(image_size, "--image-size")),
        options=CalibrationOptions(
            method=method,  # type: ignore[arg-type]
            projection=stated_once("--projection", projection, (*PROJECTIONS, "auto")) or "auto",
            mirrored=stated_once("--mirrored", mirrored, get_args(Mirrored)),
            level_within_deg=level_within,
            outwards_px=USUAL_OPTIONS.outwards_px if outwards_px is None else outwards_px,
        ),
        now=SystemClock().now(),
        circle=None if image_circle is None else parse_image_circle(image_circle),
        start=start,
        pose_only=pose_only,
        within=_prior_tolerances(lens_within, pose_within, focal_within, usable=start is not None and not pose_only),
        lens=known_lens(lens_prior, start=start, writes=write_lens_prior is not None),
        plots=plots,
        keep_provisional=provisional,
        clock_error_s=clock_error,
    )
    to_write.write([document])
    written = output if summarize_verdict(document) in _KEPT else None
    if written is not None:
        with disk_errors(written):
            written.write_text(json_text(document), encoding="utf-8")
    if output is not None and written is None:
        typer.echo(f"{output}: not written, as the calibration is not accepted", err=True)
    _print_result(document, plots, written, as_json=as_json)


def _choose_site(config: Path | None, *stated: float | None) -> Site:
    """Return the site that the options state, in the order of its fields, and the settings where one does not."""
    names = [one.name for one in fields(Site)]
    given = {name: value for name, value in zip(names, stated, strict=True) if value is not None}
    if config is not None and not {"latitude", "longitude"} <= given.keys():
        require_extra("imager", what="calibrate --config")
        known: Site = service_settings(config).place
        return replace(known, **given)
    for name in ("latitude", "longitude"):
        _require_given(given.get(name), f"--{name}")
    return Site(**{"altitude": 0.0, **given})


def _print_result(document: dict[str, Any], plots: Path | None, written: Path | None, *, as_json: bool) -> None:
    """Print a calibration; exit 1 where it is refused."""
    if as_json:
        print_json(document)
    else:
        print(calibration_text(document))
        if plots is not None:
            print(f"drawn: {plots / 'residuals.png'}, {plots / 'sky.png'}")
        if written is not None:
            print(f"written: {written}")
    if summarize_verdict(document) not in _KEPT:
        raise typer.Exit(1)


_KEPT = ("accepted", "provisional")


def _prior_tolerances(
    lens_px: float | None, pose_deg: float | None, focal_length: float | None, *, usable: bool
) -> PriorTolerances | None:
    """Return the tolerances of a start that is a prior, None where none is stated."""
    if lens_px is None and pose_deg is None and focal_length is None:
        return None
    if not usable:
        raise InputError(
            field="--lens-within",
            problem="no prior to hold to",
            remedy="name a camera with --start, without --pose-only",
        )
    if lens_px is None:
        raise InputError(
            field="--lens-within", problem="missing beside --pose-within or --focal-within", remedy="give it in px"
        )
    return PriorTolerances(lens_px=lens_px, pose_deg=pose_deg, focal_length=focal_length)


def _require_settings_only(*options: object) -> None:
    """Refuse options that belong to a file of sightings, where the settings say all."""
    if any(option is not None for option in options):
        raise InputError(
            field="POINTS",
            problem="missing, and options of a file of sightings are given",
            remedy="name the file; or leave the options out, and the archive's sightings are taken by the settings",
        )


def stated_level(settings: Settings, level_within_deg: float | None) -> Settings:
    """Return settings with the limit of the tilt that an option states."""
    if level_within_deg is None:
        return settings
    options = replace(settings.calibration, level_within_deg=level_within_deg)
    return settings.model_copy(update={"calibration": options})


def calibrate_stored(
    settings: Settings, *, provisional: bool, as_json: bool, clock_error_s: float | None = None
) -> None:
    """Fit the camera to the archive's sightings, store and print the result; exit 1 when it is refused."""
    from sunarc.imager.commands.calibrate_archive import calibrate_archive

    refit, document = calibrate_archive(
        settings, clock=SystemClock(), keep_provisional=provisional, clock_error_s=clock_error_s
    )
    if as_json:
        print_json({"state": refit.state, "message": refit.message, "calibration": document})
    elif document is None:
        print(f"no calibration: {refit.message}")
    else:
        print(calibration_text(document))
        print(f"{summarize_verdict(document)}: stored as {document['id']}")
    if refit.state != "accepted" and (document is None or summarize_verdict(document) not in _KEPT):
        raise typer.Exit(1)


def _solve_again(calibration_id: str, config: Path | None, *, as_json: bool) -> None:
    require_extra("imager", what="calibrate --again")
    from sunarc.imager.commands.calibrate_archive import solve_again

    result = solve_again(service_settings(config), calibration_id)
    if as_json:
        print_json(result)
    else:
        print(calibration_text(result["calibration"]))
        outcome = "the same camera" if result["same"] else "another camera"
        print(f"{outcome}: {result['apart_px']:.1e} px from {calibration_id} at most, {result['sightings']} sightings")
    if not result["same"]:
        raise typer.Exit(1)


def _require_given(value: Value | None, name: str) -> Value:
    if value is None:
        raise InputError(field=name, problem="missing", remedy="give it, see `sunarc calibrate --help`")
    return value
