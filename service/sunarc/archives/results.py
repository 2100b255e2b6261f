"""Output of a run: tables, calibrations, masks and exports; the same archive gives the same bytes."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.archives.fit import Final, Rough, make_epoch_document
from sunarc.archives.leaning import seen_directions
from sunarc.archives.ledger import Ledger, ParallelMap, content_key
from sunarc.archives.nights import NightsLooked
from sunarc.archives.obstructions import EpochObstructions
from sunarc.archives.passes import FROZEN, FoundSun, Looked, kept, make_image_id
from sunarc.archives.states import Epoch
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.extras import extra_module, is_installed
from sunarc.common.findings import Finding, choose_headline
from sunarc.common.foreign_files import is_regular, read_regular
from sunarc.common.json_text import json_text
from sunarc.common.utc import rfc3339, utc_time
from sunarc.imager.live.learned_sigma import series_sigma
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions
from sunarc.sources.expected_sun import PREDICTED, SEARCHED
from sunarc.sources.index import CameraImages, Failure, Indexed
from sunarc.sources.look import NamedStars, software
from sunarc.sources.sources import content_hash

_HEADER = ("camera", "time_utc", "file", "x_px", "y_px", "sigma_px", "body", "verdict", "epoch")
Document = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraResult:
    """Result of a camera.

    Attributes
    ----------
    camera : with its images.
    searched, looked : what was found in them without a prediction, and in the end.
    rough, final : states and epochs after the first pass, and after the second; None where there was none.
    obstructions : mask and horizon of each epoch.
    nights : images of the night, and the stars that were named in them.
    first_epoch : epochs of the camera before, in images of another size.
    """

    camera: CameraImages
    searched: Looked
    looked: Looked
    rough: Rough
    final: Final | None
    obstructions: tuple[EpochObstructions, ...]
    nights: NightsLooked
    first_epoch: int = 0

    @property
    def name(self) -> str:
        """Of the camera."""
        return self.camera.plan.part_of or self.camera.plan.name

    @property
    def part(self) -> str:
        """Name of its images of one size."""
        return self.camera.plan.name

    def epoch_name(self, number: int) -> str:
        """Return the name of an epoch by its number, from 0."""
        return f"{self.first_epoch + number + 1:03d}"

    @property
    def epochs(self) -> tuple[Epoch, ...]:
        """Those of the second pass."""
        return () if self.final is None else self.final.epochs


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Summary of a run: `report.json`; calibration documents by camera and epoch, and why an export is missing."""

    report: Document
    documents: Mapping[tuple[str, str], Document]

    def timed(self, seconds: float) -> Summary:
        """Return the summary with the time that the run took."""
        return replace(self, report={**self.report, "seconds": round(seconds, 1)})


def write_results(
    target: Path, results: Sequence[CameraResult], indexed: Indexed, *, each: ParallelMap | None, ledger: Ledger
) -> Summary:
    """Write the tables, calibrations, masks and exports of a run into its folder.

    Parameters
    ----------
    target : the folder.
    results : of all cameras.
    indexed : what the archive has, and what could not be used.
    each : has the exports made; None for none.
    ledger : knows which exports stand in the folder already.

    Raises
    ------
    OutsideError : something cannot be written.
    """
    documents = {
        (one.name, one.epoch_name(n)): _make_document(one, n) for one in results for n in range(len(one.epochs))
    }
    with disk_errors(target):
        shutil.rmtree(target / "calibrations", ignore_errors=True)  # of a former run, perhaps with other epochs
        _write_whole(
            target / "sightings.csv", _encode_csv(_HEADER, [row for one in results for row in _make_sighting_rows(one)])
        )
        stars = [row for one in results for row in _make_star_rows(one)]
        _write_whole(target / "stars.csv", _encode_csv(_HEADER, stars))
        _write_whole(
            target / "failures.csv", _encode_csv(("file", "code", "reason"), _make_failure_rows(results, indexed))
        )
        _write_whole(
            target / "epochs.json",
            json_text([row for one in results for row in _make_epoch_rows(one, documents)]).encode(),
        )
        for (camera, epoch), document in documents.items():
            _write_whole(target / "calibrations" / camera / f"{epoch}.json", json_text(document).encode())
        _write_obstructions(target, results)
        _write_detections(target / "detections", results, ledger)
        missing = _write_exports(target / "exports", documents if each is not None else {}, each, ledger)
    report = {
        "cameras": [_summarise_camera(one, documents) for one in results],
        "refused": [_make_refusal(one) for one in indexed.refused],
        "failures": dict(Counter(row[1] for row in _make_failure_rows(results, indexed)).most_common()),
        "headline": choose_headline(
            [one.finding for one in _list_left_out(results, indexed)],
            used=sum(len(one.looked.points()[1]) for one in results),
        ),
        "exports_missing": missing,
    }
    return Summary(report=report, documents=documents)


def _write_obstructions(target: Path, results: Sequence[CameraResult]) -> None:
    """Write the mask and the horizon of each epoch, and the picture of the newest horizon of each camera."""
    for name in ("masks", "horizons"):
        shutil.rmtree(target / name, ignore_errors=True)  # of a former run
    for one in results:
        (target / f"horizon_{one.part}.png").unlink(missing_ok=True)
        for number, shown in enumerate(one.obstructions):
            for ending, content in shown.files.items():
                folder = target / ("masks" if ending == "png" else "horizons") / one.name
                _write_whole(folder / f"{one.epoch_name(number)}.{ending}", content)
        pictures = [shown.picture for shown in sorted(one.obstructions, key=lambda shown: shown.missing is None)]
        newest = next(filter(None, reversed(pictures)), None)  # that is known, if one is
        if newest is not None:
            _write_whole(target / f"horizon_{one.part}.png", newest)


_NUMBERS_FOUND = ("x_px", "y_px", "sigma_px", "radius_px", "ellipticity", "peak_fraction", "background_fraction")


def _write_detections(folder: Path, results: Sequence[CameraResult], ledger: Ledger) -> None:
    """Write the detections in each image as Parquet, a folder for each camera, where pyarrow is installed.

    A file that was written of the same answers stays as it is.
    """
    if not is_installed("pyarrow"):
        return
    made = {f"camera={one.part}": one for one in results}
    for former in folder.glob("camera=*"):
        if former.name not in made:
            shutil.rmtree(former)
    for name, one in made.items():
        path, kept_as = folder / name / "detections.parquet", f"detections {folder.absolute()} {name}"
        times = np.array([image.time_us for image in one.looked.images], dtype=np.int64)
        key = content_key((software(), times, ledger.count_finished_chunks()))
        if not path.is_file() or ledger.result(kept_as, key) is None:
            _write_whole(path, _encode_parquet(_make_detection_columns(one, ledger)))
            ledger.keep_result(kept_as, key, True)


def _make_detection_columns(result: CameraResult, ledger: Ledger) -> dict[str, Sequence[object]]:
    """Return the detections in each image by columns: the answer that counts, with a rejected position, too."""
    images = result.looked.images
    row_by_image = {make_image_id(image): row for row, image in enumerate(images)}
    columns: dict[str, list[object]] = {name: [None] * len(images) for name in ("verdict", "code", *_NUMBERS_FOUND)}
    accepted, predicted, open_rows = [False] * len(images), [False] * len(images), set(range(len(images)))
    for row, found in enumerate(result.looked.found):
        if isinstance(found, FoundSun) and found.verdict == FROZEN:  # by the images before it, not in the ledger
            columns["verdict"][row], columns["code"][row] = FROZEN, "frame_repeated"
            open_rows.remove(row)
    for number in (PREDICTED, SEARCHED):
        for image, known in ledger.answers(result.part, pass_number=number):
            row = row_by_image.get(image, -1)
            if (
                row not in open_rows
                or isinstance(known.found, NamedStars)
                or kept(known.found) != result.looked.found[row]
            ):
                continue
            open_rows.remove(row)
            predicted[row] = number == PREDICTED
            if isinstance(known.found, Finding):
                columns["code"][row] = known.found.code
                continue
            accepted[row] = known.found.accepted
            columns["verdict"][row] = known.found.verdict
            columns["code"][row] = known.found.findings[0].code if known.found.findings else None
            for name in _NUMBERS_FOUND:
                columns[name][row] = getattr(known.found, name)
    return {
        "time_us": [image.time_us for image in images],
        "file": [image.path for image in images],
        "source": [image.address for image in images],
        "exposure_us": [image.exposure_us for image in images],
        "accepted": accepted,
        "predicted": predicted,
        **columns,
    }


def _encode_parquet(columns: Mapping[str, Sequence[object]]) -> bytes:
    arrow, parquet = (extra_module(name, extra="parquet") for name in ("pyarrow", "pyarrow.parquet"))
    text, number = arrow.dictionary(arrow.int32(), arrow.string()), arrow.float64()
    kinds = {
        "time_us": arrow.timestamp("us", tz="UTC"), "file": arrow.string(), "source": text, "verdict": text,
        "code": text, "accepted": arrow.bool_(), "predicted": arrow.bool_(),
    }  # fmt: skip
    arrays = [arrow.array(values, type=kinds.get(name, number)) for name, values in columns.items()]
    names = ["time_utc" if name == "time_us" else name for name in columns]
    target = io.BytesIO()
    parquet.write_table(arrow.table(arrays, names=names), target, compression="zstd")
    return target.getvalue()


def _make_document(result: CameraResult, number: int) -> Document:
    assert result.final is not None  # noqa: S101 - it has epochs
    epoch = result.final.epochs[number]
    state = result.final.states[epoch.state]
    shown = result.obstructions[number]
    evidence = {} if shown.missing else {"horizon_seen": shown.seen, "horizon_hidden": shown.hidden}
    return make_epoch_document(
        result.final.fitted[state.pose],
        result.looked.points()[0],
        epoch,
        camera=result.name,
        name=result.epoch_name(number),
        evidence=evidence,
        clock_error_s=result.camera.plan.clock_error_s,
    )


def _make_sighting_rows(result: CameraResult) -> list[tuple[object, ...]]:
    """Return the accepted sightings, at the times that their epoch's clock is corrected to."""
    points, rows = result.looked.points()
    if result.final is None:
        epochs, offsets, sigmas = [""] * len(rows), [0.0] * len(rows), points.sigma_px.tolist()
    else:
        epochs = [
            result.epoch_name(n) if one.start_unix_s <= unix_s <= one.end_unix_s else ""
            for n, one in enumerate(result.epochs)
            for unix_s in points.unix_s[one.first : one.last + 1].tolist()
        ]
        offsets = [result.final.states[number].clock_offset_s for number in result.final.path.tolist()]
        sigmas = _compute_sigmas(result, offsets).tolist()
    table = []
    for row, epoch, offset_s, sigma_px in zip(rows, epochs, offsets, sigmas, strict=True):
        image, found = result.looked.images[row], result.looked.found[row]
        assert isinstance(found, FoundSun)  # noqa: S101 - it was accepted
        sigma = None if found.sigma_px is None else round(sigma_px, 4)
        time = rfc3339(utc_time(image.unix_s - offset_s))
        pixel = (round(found.x_px or 0.0, 4), round(found.y_px or 0.0, 4))
        table.append((result.name, time, image.name, *pixel, sigma, "sun", found.verdict, epoch))
    return sorted(table, key=lambda one: (str(one[1]), str(one[2])))


def _make_star_rows(result: CameraResult) -> list[tuple[object, ...]]:
    """Return the sightings of stars and planets, at the times that their epoch's clock is corrected to."""
    table = []
    for night, image, stars in result.nights.named():
        time = rfc3339(utc_time(image.unix_s - night.naming.clock_offset_s))
        epoch = result.epoch_name(night.epoch)
        table += [
            (result.name, time, image.name, x, y, sigma, body, "clear", epoch) for body, x, y, sigma in stars.rows
        ]
    return sorted(table, key=lambda one: (str(one[1]), str(one[2]), str(one[6])))


def _compute_sigmas(result: CameraResult, offsets: Sequence[float]) -> FloatArray:
    """Return (n,): the sigma of each accepted sighting by those of its kind of sky about the accepted calibrations."""
    assert result.final is not None  # noqa: S101 - it has offsets
    points, rows = result.looked.points()
    residual = np.full_like(points.pixels, np.nan)
    directions = sun_directions(points.unix_s - offsets, result.camera.plan.site)
    for number, state in enumerate(result.final.states):
        calibration = result.final.fitted[state.pose].calibration
        if calibration.verdict.accepted:
            held = result.final.path == number
            seen = seen_directions(calibration, directions[held], (points.unix_s - offsets)[held])
            residual[held] = points.pixels[held] - project(calibration.camera, seen)
    sky = [one.verdict for one in map(result.looked.found.__getitem__, rows) if isinstance(one, FoundSun)]
    return series_sigma(residual, points.sigma_px, sky)


def _make_failure_rows(results: Sequence[CameraResult], indexed: Indexed) -> list[tuple[str, str, str]]:
    return sorted((one.file, one.finding.code, one.finding.text) for one in _list_left_out(results, indexed))


def _list_left_out(results: Sequence[CameraResult], indexed: Indexed) -> list[Failure]:
    by_day = {image.name for one in results for image in one.camera.images}
    night = [one for one in indexed.failures if one.finding.code == "file_at_night" and one.file in by_day]
    found = [*(one for one in indexed.failures if one not in night), *indexed.refused]
    for one in results:
        for looked in (one.looked, one.nights.looked):
            answers = zip(looked.images, looked.found, strict=True)
            found += [Failure(image.name, answer) for image, answer in answers if isinstance(answer, Finding)]
        found += [Failure(image.name, Finding("night_between_poses")) for image in one.nights.nights.left_out]
    return found


def _make_epoch_rows(result: CameraResult, documents: Mapping[tuple[str, str], Document]) -> list[Document]:
    rows = []
    for number, epoch in enumerate(result.epochs):
        assert result.final is not None  # noqa: S101 - it has epochs
        name = result.epoch_name(number)
        state = result.final.states[epoch.state]
        document = documents[result.name, name]
        rows.append(
            {
                "camera": result.name,
                "epoch": name,
                "start": rfc3339(utc_time(epoch.start_unix_s)),
                "end": rfc3339(utc_time(epoch.end_unix_s)),
                "cause": epoch.cause,
                "clock_offset_s": state.clock_offset_s,
                "calibration": f"calibrations/{result.name}/{name}.json",
                "accepted": document["verdict"]["accepted"],
                "provisional": _is_provisional(document),
                "sightings": epoch.last - epoch.first + 1,
            }
        )
    return rows


def _is_provisional(document: Document) -> bool:
    """Return whether a calibration is kept though its sightings do not determine it; a doubtful one is refused."""
    return document["uncertainty"].get("sigma_limit_deg") is not None


def _summarise_camera(result: CameraResult, documents: Mapping[tuple[str, str], Document]) -> Document:
    def count_accepted(looked: Looked) -> int:
        return sum(isinstance(one, FoundSun) and one.accepted for one in looked.found)

    verdicts = Counter(one.verdict for one in result.looked.found if isinstance(one, FoundSun))
    pairs = [
        tuple(isinstance(one, FoundSun) and one.accepted for one in both)
        for both in zip(result.searched.found, result.looked.found, strict=True)
    ]
    return {
        "camera": result.name,
        "images": len(result.camera.images),
        "size": list(result.camera.size),
        "times": {"by": result.camera.family, "example": list(result.camera.example)},
        "accepted_first_pass": count_accepted(result.searched),
        "accepted": count_accepted(result.looked),
        "second_pass": {"found": pairs.count((False, True)), "refused": pairs.count((True, False))},
        "by_verdict": dict(verdicts.most_common()),
        "findings": [
            {**one.as_json(), "reason": one.sentence} for one in (*result.camera.findings, *result.rough.findings)
        ],
        "nights": _summarise_nights(result),
        "epochs": [_epoch_summary(result, n, documents) for n in range(len(result.epochs))],
    }


def _summarise_nights(result: CameraResult) -> dict[str, int]:
    named = list(result.nights.named())
    return {
        "nights": len(result.nights.nights.nights),
        "images": len(result.camera.nights),
        "looked_at": len(result.nights.looked.images),
        "accepted": len(named),
        "stars": sum(len(one.stars.rows) for one in named),
    }


def _epoch_summary(result: CameraResult, number: int, documents: Mapping[tuple[str, str], Document]) -> Document:
    document = documents[result.name, result.epoch_name(number)]
    epoch, shown = _make_epoch_rows(result, documents)[number], result.obstructions[number]
    return {
        **epoch,
        "rmse_px": document["metrics"]["rmse_px"],
        "rmse_deg": document["metrics"]["rmse_deg"],
        "sky_rms_deg": document["uncertainty"]["sky_rms_deg"],
        "reasons": document["verdict"]["reasons"],
        "horizon": {"missing": shown.missing} if shown.missing else {"seen": shown.seen, "hidden": shown.hidden},
    }


def _make_refusal(failure: Failure) -> Document:
    return {"camera": failure.file, **failure.finding.as_json(), "reason": failure.finding.sentence}


def _write_exports(
    folder: Path, documents: Mapping[tuple[str, str], Document], each: ParallelMap | None, ledger: Ledger
) -> dict[str, dict[str, str]]:
    """Write calibrations in all formats; return why some are missing, by calibration and format.

    Files that were made of the same calibration stay as they are; those of a former run's others are removed.
    """
    usable = {
        f"{camera}/{epoch}": one
        for (camera, epoch), one in documents.items()
        if one["verdict"]["accepted"] or _is_provisional(one)
    }
    for former in folder.glob("*/*"):
        if former.relative_to(folder).as_posix() not in usable:
            shutil.rmtree(former)
    keys = {name: content_key((software(), json.dumps(one))) for name, one in usable.items()}
    kept = {name: ledger.result(f"exports {folder.absolute()} {name}", key) for name, key in keys.items()}
    new = [name for name, one in kept.items() if one is None or not _is_folder_unchanged(folder / name, one["files"])]
    made = each(export_all_formats, [usable[name] for name in new]) if each is not None else []
    for name, one in zip(new, made, strict=True):
        files, refused = one or ({}, {"all": "the workers that made them died"})
        shutil.rmtree(folder / name, ignore_errors=True)
        for file, content in files.items():
            _write_whole(folder / name / file, content)
        kept[name] = {"files": {file: content_hash(content) for file, content in files.items()}, "refused": refused}
        if one is not None:
            ledger.keep_result(f"exports {folder.absolute()} {name}", keys[name], kept[name])
    return {name: kept[name]["refused"] for name in usable if kept[name]["refused"]}


def _is_folder_unchanged(folder: Path, files: Mapping[str, str]) -> bool:
    """Return whether a folder's files have the content that they were written with."""
    return all(
        is_regular(path := folder / name) and content_hash(read_regular(path)) == one for name, one in files.items()
    )


def export_all_formats(document: Document) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return the files of a calibration in all formats, and why some have none."""
    from sunarc.formats.formats import FORMATS, export  # noqa: PLC0415 - a run that makes none does without

    files: dict[str, bytes] = {}
    refused: dict[str, str] = {}
    for form in FORMATS.values():
        if form.name == "map-npz":  # the map is written once
            continue
        try:
            made = export(document, form.name)
        except InputError as error:
            refused[form.name] = str(error)
            continue
        folder = "" if form.media_type or not made.name else f"{form.name}/"
        files |= {f"{folder}{name or form.file}": content for name, content in made.files.items()}
    return files, refused


def _encode_csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file as a whole: a reader finds the former one or this."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.new")
    beside.write_bytes(content)
    beside.replace(path)
