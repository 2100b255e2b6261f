"""An archive analysed again: index, both passes, epochs, calibrations, and its output."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from sunarc.archives.cluster import DEATHS, Cluster, ClusterWhenNeeded, Workers, open_cluster
from sunarc.archives.fit import (
    CameraSightings,
    Final,
    Rough,
    StarFitInput,
    final_analysis,
    first_analysis,
    kept_provisional,
    starry_analysis,
    without_suns,
)
from sunarc.archives.ledger import Ledger
from sunarc.archives.nights import NightsLooked, collect_nights, name_stars, star_points
from sunarc.archives.obstructions import EpochObstructions, epoch_obstructions, select_epoch_images
from sunarc.archives.passes import (
    Looked,
    Passes,
    by_true_times,
    epoch_at,
    predictions,
    without_frozen,
    without_lifted,
)
from sunarc.archives.report import write_report
from sunarc.archives.results import CameraResult, Summary, write_results
from sunarc.archives.star_start import CameraNightImages, first_by_stars
from sunarc.archives.states import ArchiveCamera, known_state
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.quality.fit_checks import unstated_tilt_deg
from sunarc.calibration.quality.tilt import proposed_limit_deg
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import Finding, choose_headline
from sunarc.imager.archive.database.state_folder import lock_state
from sunarc.imager.runtime.clock import Clock
from sunarc.public.calibration_files import read_calibration
from sunarc.sources.index import CameraImages, Indexed, ReportProgress
from sunarc.sources.look import PackedMask

_ANOTHER = "wait for that run to end, or give another folder (-o)"
_DIED = Finding("camera_kills_workers", {"deaths": DEATHS})


@dataclass(frozen=True, slots=True, kw_only=True)
class ReanalysisOptions:
    """Options of the analysis of an archive.

    Attributes
    ----------
    target : folder of the results.
    store : address of the ledger (SQLAlchemy); None for `ledger.sqlite` in the folder.
    workers : where the images are read.
    exports : whether the calibrations are written in all formats, too.
    provisional : whether a calibration that its sightings do not determine is kept, see `provisional`.
    """

    target: Path
    store: str | None = None
    workers: Workers = field(default_factory=Workers)
    exports: bool = True
    provisional: bool = False


def reanalyse(
    indexed: Indexed,
    options: ReanalysisOptions,
    *,
    clock: Clock,
    opened: Callable[[Cluster], None] = lambda _: None,
    progress: ReportProgress = lambda *_: None,
) -> Summary:
    """Find every sun of an archive, the epochs of its cameras, and a calibration for each; write it all into a folder.

    What is done already by this version of the software stands in the ledger, and is not done again.

    Parameters
    ----------
    indexed : the cameras and their images.
    options : how.
    clock : for waits, and for the time that it took.
    opened : called with the cluster once it is there; not called without new work.
    progress : called after every chunk.

    Raises
    ------
    InputError : there is no camera with images.
    OutsideError : the folder cannot be written or another run writes into it, or no worker answers.
    """
    if not indexed.cameras:
        cause = choose_headline([one.finding for one in indexed.failures or indexed.refused], used=0)
        why = "" if cause is None else f"; {cause['n']} left out: {cause['reason']} [{cause['code']}]"
        raise InputError(field="SOURCE", problem=f"has no image to look at{why}", remedy="see above")
    began = clock.monotonic()
    with disk_errors(options.target):
        options.target.mkdir(parents=True, exist_ok=True)
    store = options.store or f"sqlite:///{options.target / 'ledger.sqlite'}"
    given = [_load_given_calibration(one) for one in indexed.cameras]
    with (
        lock_state(options.target, remedy=_ANOTHER),
        Ledger(store) as ledger,
        ClusterWhenNeeded(partial(open_cluster, options.workers, clock=clock), opened) as cluster,
    ):
        results = _analyse_cameras(indexed.cameras, given, Passes(ledger, cluster, progress), ledger)
        if options.provisional:
            results = [_keep_provisional(one) for one in results]
        summary = write_results(
            options.target, results, indexed, each=cluster.each if options.exports else None, ledger=ledger
        )
    summary = summary.timed(clock.monotonic() - began)
    write_report(options.target, summary, results)
    return summary


def _analyse_cameras(
    stated: Sequence[CameraImages], started: Sequence[Calibration | None], passes: Passes, ledger: Ledger
) -> list[CameraResult]:
    cameras = list(stated)
    names, each = [one.plan.name for one in cameras], passes.cluster.each
    masks = passes.masks(cameras)
    searched = _search_without_prediction(cameras, masks, passes)
    given = [_make_camera_sightings(*one) for one in zip(cameras, searched, started, strict=True)]
    passes.progress("epochs", 0, len(cameras))
    rough = [one or Rough(findings=(_DIED,)) for one in ledger.each(each, first_analysis, given, names=names)]
    rough = _analyse_by_stars(cameras, given, rough, passes, ledger)
    passes.progress("epochs", len(cameras), len(cameras))
    found = [n for n, one in enumerate(rough) if one.states]
    lit = {n: by_true_times(cameras[n], rough[n].states, rough[n].epochs) for n in found}
    later = [n for n, one in lit.items() if one.images != cameras[n].images]
    again_searched = _search_without_prediction([lit[n] for n in later], [masks[n] for n in later], passes)
    for n, one in zip(later, again_searched, strict=True):
        cameras[n], searched[n] = lit[n], one
    expected = (predictions(cameras[n], rough[n].states, rough[n].epochs) for n in found)
    waiting = [(cameras[n], searched[n]) for n in found]
    looked = dict(zip(found, passes.predict(waiting, expected, [masks[n] for n in found]), strict=True))
    again = {n: CameraSightings(looked[n].points()[0], given[n].camera, rough[n].states) for n in found}
    passes.progress("calibrations", 0, len(found))
    sunny = [n for n in found if len(again[n].points)]
    fitted = ledger.each(each, final_analysis, [again[n] for n in sunny], names=[names[n] for n in sunny])
    final = {n: without_suns(rough[n]) for n in found} | dict(zip(sunny, fitted, strict=True))
    held = {n: _keep_accepted_epochs(searched[n], looked[n], one) for n, one in final.items() if one is not None}
    fewer = [n for n, one in held.items() if one.found != looked[n].found]
    looked |= held
    again |= {n: CameraSightings(looked[n].points()[0], given[n].camera, rough[n].states) for n in fewer}
    fitted = ledger.each(each, final_analysis, [again[n] for n in fewer], names=[f"{names[n]}, fewer" for n in fewer])
    final |= dict(zip(fewer, fitted, strict=True))
    passes.progress("calibrations", len(found), len(found))
    nights = _name_night_stars(cameras, final, _find_no_sky_masks(cameras, looked, final, passes, ledger), passes)
    final |= _add_stars(nights, final, again, passes, ledger)
    final = {n: None if one is None else one.drop_uncalibrated() for n, one in final.items()}
    obstructions = _find_obstructions(cameras, looked, final, passes, ledger)
    return _number_epochs(
        [
            CameraResult(
                camera=camera,
                searched=searched[n],
                looked=looked.get(n, searched[n]),
                rough=rough[n],
                final=final.get(n),
                obstructions=obstructions.get(n, ()),
                nights=nights[n],
            )
            for n, camera in enumerate(cameras)
        ]
    )


def _number_epochs(results: Sequence[CameraResult]) -> list[CameraResult]:
    """Return results, those of a camera whose picture was resized with one numbering of epochs in the order of time."""
    before: dict[str, int] = {}
    numbered: dict[str, CameraResult] = {}
    for one in sorted(results, key=lambda one: one.epochs[0].start_unix_s if one.epochs else 0.0):
        numbered[one.part] = replace(one, first_epoch=before.get(one.name, 0))
        if one.epochs and before.get(one.name) and one.final is not None:
            first, *others = one.epochs
            final = one.final._replace(epochs=(first._replace(cause="resized"), *others))
            numbered[one.part] = replace(numbered[one.part], final=final)
        before[one.name] = before.get(one.name, 0) + len(one.epochs)
    return [numbered[one.part] for one in results]


def _search_without_prediction(
    cameras: Sequence[CameraImages], masks: Sequence[PackedMask | None], passes: Passes
) -> list[Looked]:
    """Return the detections without a prediction, those of images that came before rejected."""
    found = passes.search(cameras, masks) if cameras else []
    return [without_frozen(one, camera.plan.site) for camera, one in zip(cameras, found, strict=True)]


def _keep_accepted_epochs(searched: Looked, looked: Looked, final: Final) -> Looked:
    """Return the second pass without the suns that only the prediction of a refused epoch has accepted."""
    if not final.fitted:
        return looked
    accepted = [final.fitted[final.states[one.state].pose].calibration.verdict.accepted for one in final.epochs]
    refused = [not accepted[epoch_at(final.epochs, image.unix_s)] for image in looked.images]
    return without_lifted(searched, looked, refused)


def _keep_provisional(result: CameraResult) -> CameraResult:
    final = result.final
    return result if final is None else replace(result, final=kept_provisional(final, _load_known(result.camera)))


def _find_no_sky_masks(
    cameras: Sequence[CameraImages],
    looked: Mapping[int, Looked],
    final: Mapping[int, Final | None],
    passes: Passes,
    ledger: Ledger,
) -> dict[int, list[PackedMask | None]]:
    """Return the parts of the images that show no sky in each epoch of the cameras that have suns and nights."""
    sunny = {n: one for n, one in final.items() if one is not None and one.epochs == one.drop_uncalibrated().epochs}
    starry = {n: one for n, one in sunny.items() if cameras[n].nights}
    found = _find_obstructions(cameras, looked, starry, passes, ledger, title=", before its stars")
    return {number: [one.no_sky() for one in of_epochs] for number, of_epochs in found.items()}


def _name_night_stars(
    cameras: Sequence[CameraImages],
    final: Mapping[int, Final | None],
    hidden: Mapping[int, Sequence[PackedMask | None]],
    passes: Passes,
) -> list[NightsLooked]:
    """Return the nights of each camera, with the stars that are named in their images."""
    every = []
    for number, camera in enumerate(cameras):
        one = final.get(number)
        states, epochs = ((), ()) if one is None else (one.states, one.epochs)
        every.append(collect_nights(camera, states, epochs, hidden.get(number, ())))
    named = passes.name([one.work() for one in every], run=name_stars)
    return [NightsLooked(one, looked) for one, looked in zip(every, named, strict=True)]


def _add_stars(
    nights: Sequence[NightsLooked],
    final: Mapping[int, Final | None],
    suns: Mapping[int, CameraSightings],
    passes: Passes,
    ledger: Ledger,
) -> dict[int, Final]:
    """Return the cameras with their stars, by number; an error of the stars' workers changes nothing."""
    starry: dict[int, StarFitInput] = {}
    for number, one in final.items():
        stars = None if one is None else star_points(nights[number], one.states, one.epochs)
        if one is not None and stars is not None:
            starry[number] = StarFitInput(suns[number], one, stars)
    names = [nights[number].nights.camera.plan.name for number in starry]
    fitted = ledger.each(passes.cluster.each, starry_analysis, list(starry.values()), names=names)
    return {number: one for number, one in zip(starry, fitted, strict=True) if one is not None}


def _load_given_calibration(camera: CameraImages) -> Calibration | None:
    """Return the calibration that a camera's search begins with; InputError where it is of images of another size."""
    if camera.plan.calibration is None:
        return None
    found = read_calibration(camera.plan.calibration)
    size = (found.camera.width, found.camera.height)
    if size != camera.size and camera.plan.part_of is not None:
        return None
    if size != camera.size:
        raise InputError(
            field=str(camera.plan.calibration),
            problem=f"is of {size} px, the images of {camera.plan.name} of {camera.size}",
            remedy="give the calibration of this camera",
        )
    return replace(found, site=camera.plan.site)


def _make_camera_sightings(camera: CameraImages, looked: Looked, given: Calibration | None) -> CameraSightings:
    """Return a camera's sightings; where it is given, with its state, whose tilt is then known."""
    points, known = looked.points()[0], _load_known(camera)
    if given is None:
        return CameraSightings(points, known)
    tilt_deg = unstated_tilt_deg(given) if given.verdict.accepted else None
    if known.options.level_within_deg is None and tilt_deg is not None:
        options = replace(known.options, level_within_deg=proposed_limit_deg(tilt_deg))
        known = known._replace(options=options)
    return CameraSightings(points, known, (known_state(given, points),))


def _analyse_by_stars(
    cameras: Sequence[CameraImages],
    given: Sequence[CameraSightings],
    rough: Sequence[Rough],
    passes: Passes,
    ledger: Ledger,
) -> list[Rough]:
    """Return states and epochs, those of cameras without a sun by the stars of their nights."""
    dark = [n for n, one in enumerate(cameras) if one.nights and not (rough[n].states and one.images)]
    nights = [CameraNightImages(cameras[n].nights, given[n].camera, given[n].states) for n in dark]
    found = ledger.each(passes.cluster.each, first_by_stars, nights, names=[cameras[n].plan.name for n in dark])
    started = dict(zip(dark, found, strict=True))
    return [_choose_sun_or_stars(one, started.get(n), suns=bool(cameras[n].images)) for n, one in enumerate(rough)]


def _choose_sun_or_stars(rough: Rough, stars: Rough | None, *, suns: bool) -> Rough:
    if stars is None or stars.states:
        return stars or rough
    return rough if suns else stars


def _find_obstructions(
    cameras: Sequence[CameraImages],
    looked: Mapping[int, Looked],
    final: Mapping[int, Final | None],
    passes: Passes,
    ledger: Ledger,
    *,
    title: str = "",
) -> dict[int, tuple[EpochObstructions, ...]]:
    """Return mask and horizon of each epoch of the cameras, by number, or that the worker that made them died."""
    found = {}
    for number, one in final.items():
        if one is None:
            continue
        given = select_epoch_images(looked[number], one, cameras[number].size)
        names = [f"{cameras[number].plan.name} {epoch}{title}" for epoch in range(len(given))]
        made = ledger.each(passes.cluster.each, epoch_obstructions, given, names=names)
        found[number] = tuple(each or EpochObstructions({}, 0, 0, "the worker that made it died", b"") for each in made)
    return found


def _load_known(camera: CameraImages) -> ArchiveCamera:
    return ArchiveCamera(camera.plan.site, camera.size, camera.plan.options)
