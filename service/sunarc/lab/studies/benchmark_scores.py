"""Scores of the benchmark: an entrant's directions against the truth, by zenith angle and far from the sun's track.

What a limit or a band is stands here, before an entry is scored (docs/benchmark/README.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import direction_covariance, project_with_covariance
from sunarc.calibration.model.options import CalibrationOptions, Method
from sunarc.calibration.model.result import Calibration
from sunarc.changes.record import calibrate_moved
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.findings import Finding
from sunarc.common.messages import significant
from sunarc.lab.studies.benchmark_cases import FAR_DEG, BenchmarkCase, BenchmarkTruth, neighbouring_directions
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angles_from_direction, angular_distance

Answer = Literal["answered", "refused", "failed"]
SHARES = (0.50, 0.68, 0.95)
"""Within whose stated ellipses the truth is counted."""
WITHIN: Mapping[float, tuple[float, float]] = {0.50: (0.45, 0.55), 0.68: (0.63, 0.73), 0.95: (0.92, 0.98)}
"""Bounds of a share that is as stated."""
BANDS: Mapping[str, tuple[float, float]] = {
    "0-30": (0.0, 30.0), "30-60": (30.0, 60.0), "60-70": (60.0, 70.0), "70-85": (70.0, 85.0), "85-90": (85.0, 90.0),
}  # fmt: skip
"""Zenith angles, degrees, from and below."""
FAR_SIGMAS = 3.0
"""Stated sigmas beyond which an answered case is off by more than it says."""
_TILTED_DEG = 45.0
"""Tilt that is stated of the cases, which hold cameras tilted by up to 40 degrees."""
_ZERO_DEG = 1e-12
_MEDIAN = 2.0 * math.log(2.0)
"""Of the square of a distance in 1-sigmas of two axes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answered:
    """Answer of an entrant to one case.

    Attributes
    ----------
    answer : "refused": it said that it cannot; "failed": nothing that can be read.
    directions : (m, 3) of the pixels asked for, in their order; NaN where nothing is said.
    covariance : (m, 2, 2) deg², by zenith angle and azimuth on the sphere; None: not stated.
    scales : (m, 3) what a 1-sigma is multiplied by for the ellipses of `SHARES`; 1 for a Gaussian.
    processor_s : that it took; NaN: not stated.
    findings : what is wrong with the entry.
    """

    answer: Answer
    directions: FloatArray
    covariance: FloatArray | None = None
    scales: FloatArray | None = None
    processor_s: float = math.nan
    findings: tuple[Finding, ...] = ()


class _CaseErrors(NamedTuple):
    """Errors of one case: (m,) degrees, px, and squared in stated sigmas; (m, 3) whether within; NaN: none stated."""

    error_deg: FloatArray
    error_px: FloatArray
    square: FloatArray
    within: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseScore:
    """One case of one entrant.

    Attributes
    ----------
    sigmas : median distance from the truth in stated 1-sigmas, over that of a Gaussian; NaN where none is stated.
    wrong : answered, and worse than no calibration at all.
    """

    case: str
    lens: str
    condition: str
    answerable: bool
    answer: Answer
    median_deg: float
    p90_deg: float
    sigmas: float
    wrong: bool
    processor_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BandScore:
    """Score of the pixels of one band, of all cases: a lost case counts with the error of the fallback.

    `within` has the share of `SHARES` that lies in the stated ellipses, NaN where none is stated.
    """

    band: str
    n: int
    median_deg: float
    p90_deg: float
    median_px: float
    p90_px: float
    within: tuple[float, float, float]

    def as_stated(self, share: int) -> bool:
        """Return whether a share of `SHARES`, by its place, was found within its bounds."""
        low, high = WITHIN[SHARES[share]]
        return low <= self.within[share] <= high


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Score of an entrant.

    Attributes
    ----------
    bands : those of `BANDS`, "far" from the track, and "all".
    refused_rightly, unanswerable : cases refused of those that the sightings do not determine, and how many these are.
    refused_wrongly, answerable : the same of those that they do.
    wrong : cases answered with a median error larger than who has no calibration has.
    far : cases off by more than `FAR_SIGMAS`.
    lost : cases neither answered nor refused.
    processor_s : in all; NaN where no case states it.
    """

    entrant: str
    bands: tuple[BandScore, ...]
    cases: tuple[CaseScore, ...]
    refused_rightly: int
    unanswerable: int
    refused_wrongly: int
    answerable: int
    wrong: int
    far: int
    lost: int
    processor_s: float
    findings: tuple[Finding, ...] = field(default=())


def collect_answers(calibration: Calibration, pixels: FloatArray, *, processor_s: float = math.nan) -> Answered:
    """Return the answers of a calibration about pixels (m, 2); empty for a refused one."""
    directions = unproject(calibration.camera, pixels)
    if not calibration.verdict.accepted:
        return Answered(answer="refused", directions=np.full((len(pixels), 3), np.nan), processor_s=processor_s)
    known = np.all(np.isfinite(directions), axis=-1)
    covariance, scales = np.full((len(pixels), 2, 2), np.nan), np.ones((len(pixels), len(SHARES)))
    _, of_pixels = project_with_covariance(calibration, directions[known])
    of_vectors = direction_covariance(calibration.camera, directions[known], of_pixels)
    sides = np.stack(neighbouring_directions(directions[known]), axis=-1)
    covariance[known] = np.swapaxes(sides, -1, -2) @ of_vectors @ sides * math.degrees(1.0) ** 2
    if calibration.mixture is not None:
        factors = [calibration.mixture.sigma_factors(pixels, share) for share in SHARES]
        scales = np.stack(factors, axis=-1)
    return Answered(
        answer="answered", directions=directions, covariance=covariance, scales=scales, processor_s=processor_s
    )


def calibrate_case(case: BenchmarkCase, method: Method) -> Calibration:
    """Return this package's calibration of a case, as `sunarc calibrate` would make it."""
    options = CalibrationOptions(method=method, projection=case.projection or "auto", level_within_deg=_TILTED_DEG)
    return calibrate_moved(case.sightings, site=case.site, image_size=case.image_size, options=options).calibration


def score(entrant: str, truths: Mapping[str, BenchmarkTruth], answers: Mapping[str, Answered]) -> Score:
    """Score an entrant; a case without an answer is lost.

    Parameters
    ----------
    entrant : its name.
    truths : by case.
    answers : by case; others than those of the truths are a finding.
    """
    findings = [Finding("benchmark_case_unknown", {"case": name}) for name in sorted(set(answers) - set(truths))]
    judged: list[tuple[BenchmarkTruth, Answered, _CaseErrors]] = []
    cases: list[CaseScore] = []
    for name, truth in truths.items():
        given = answers.get(name)
        if given is None:
            given = Answered(answer="failed", directions=np.full(truth.directions.shape, np.nan))
            findings.append(Finding("benchmark_case_missing", {"case": name}))
        rows, found = _compute_case_errors(name, truth, given)
        findings += [*given.findings, *found]
        judged.append((truth, given, rows))
        cases.append(_make_case_score(name, truth, given, rows))
    times = [case.processor_s for case in cases if math.isfinite(case.processor_s)]
    return Score(
        entrant=entrant,
        bands=tuple(_score_bands(judged)),
        cases=tuple(cases),
        refused_rightly=sum(case.answer == "refused" and not case.answerable for case in cases),
        unanswerable=sum(not case.answerable for case in cases),
        refused_wrongly=sum(case.answer == "refused" and case.answerable for case in cases),
        answerable=sum(case.answerable for case in cases),
        wrong=sum(case.wrong for case in cases),
        far=sum(case.sigmas > FAR_SIGMAS for case in cases),
        lost=sum(case.answer == "failed" for case in cases),
        processor_s=math.fsum(times) if times else math.nan,
        findings=tuple(findings),
    )


def _compute_case_errors(name: str, truth: BenchmarkTruth, given: Answered) -> tuple[_CaseErrors, list[Finding]]:
    """Return the errors of a case, and the fault in its numbers."""
    total = truth.directions.shape[0]
    known = np.all(np.isfinite(given.directions), axis=-1) & (given.answer == "answered")
    seen = np.where(known[:, None], given.directions, truth.directions)
    angle = np.degrees(angular_distance(seen, truth.directions))
    tangent = np.stack(
        [np.sum((seen - truth.directions) * side, axis=-1) for side in neighbouring_directions(truth.directions)], -1
    )
    length = np.linalg.norm(tangent, axis=-1)
    # the chord's direction, with the angle's length: right at any size of the error
    offset = tangent / np.maximum(length, 1e-300)[:, None] * angle[:, None]
    error_px = np.linalg.norm(np.einsum("nab,nb->na", truth.px_per_deg, offset), axis=-1)
    scale = np.sqrt(np.abs(np.linalg.det(truth.px_per_deg)))
    square, within, found = _compare_with_stated(name, offset, given, known)
    rows = _CaseErrors(
        error_deg=np.where(known, angle, truth.fallback_deg),
        error_px=np.where(known, error_px, truth.fallback_deg * scale),
        square=square,
        within=within,
    )
    undefined = int(np.sum(~known)) if given.answer == "answered" else 0
    missing = sum(int(one.data["n"]) for one in given.findings if one.code == "benchmark_rows_missing")
    if undefined > missing:
        found.append(Finding("benchmark_rows_undefined", {"case": name, "n": undefined - missing, "of": total}))
    return rows, found


def _compare_with_stated(
    name: str, offset: FloatArray, given: Answered, known: BoolArray
) -> tuple[FloatArray, FloatArray, list[Finding]]:
    """Return (m,) squares in stated sigmas, and (m, 3) whether within; NaN where no error or direction is stated."""
    squares, within = np.full(offset.shape[0], np.nan), np.full((offset.shape[0], len(SHARES)), np.nan)
    if given.covariance is None or not np.any(known):
        return squares, within, []
    covariance = given.covariance[known]
    (a, b), (_, c) = np.moveaxis(covariance, 0, -1)
    scales = np.ones((offset.shape[0], len(SHARES))) if given.scales is None else given.scales
    scales = scales[known]
    determinant = a * c - b * b
    zero = ((a == 0.0) & (c == 0.0)) | np.any(scales == 0.0, axis=-1)
    usable = np.isfinite(determinant) & (a > 0.0) & (c > 0.0) & (determinant > 0.0)
    usable &= ~zero & np.all(np.isfinite(scales) & (scales > 0.0), axis=-1)
    x, y = offset[known].T
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.where(usable, (c * x * x - 2.0 * b * x * y + a * y * y) / determinant, np.inf)
    square = np.where(zero & (np.hypot(x, y) < _ZERO_DEG), 0.0, square)
    limits = scales**2 * np.array([-2.0 * math.log1p(-share) for share in SHARES])
    squares[known], within[known] = square, square[:, None] <= limits
    found = []
    for code, which in (("benchmark_sigma_zero", zero), ("benchmark_sigma_undefined", ~usable & ~zero)):
        if np.any(which):
            found.append(Finding(code, {"case": name, "n": int(which.sum()), "of": int(which.size)}))
    return squares, within, found


def _make_case_score(name: str, truth: BenchmarkTruth, given: Answered, rows: _CaseErrors) -> CaseScore:
    median, stated = float(np.median(rows.error_deg)), rows.square[np.isfinite(rows.within[:, 0])]
    return CaseScore(
        case=name,
        lens=truth.lens,
        condition=truth.condition,
        answerable=truth.answerable,
        answer=given.answer,
        median_deg=median,
        p90_deg=float(np.quantile(rows.error_deg, 0.9)),
        sigmas=math.sqrt(float(np.median(stated)) / _MEDIAN) if stated.size else math.nan,
        wrong=given.answer == "answered" and median > float(np.median(truth.fallback_deg)),
        processor_s=given.processor_s,
    )


def _score_bands(judged: Sequence[tuple[BenchmarkTruth, Answered, _CaseErrors]]) -> Iterator[BandScore]:
    """Yield the scores of each band, of the pixels far from the track, and of all."""
    if not judged:
        return
    zenith = np.concatenate([angles_from_direction(truth.directions)[0] for truth, _, _ in judged])
    track = np.concatenate([truth.track_deg for truth, _, _ in judged])
    rows = _CaseErrors(*(np.concatenate(columns) for columns in zip(*(rows for _, _, rows in judged), strict=True)))
    chosen = {name: (zenith >= low) & (zenith < high) for name, (low, high) in BANDS.items()}
    chosen |= {"far": track > FAR_DEG, "all": np.ones(zenith.size, dtype=bool)}
    for name, of_band in chosen.items():
        if np.any(of_band):
            yield _score_band(name, _CaseErrors(*(column[of_band] for column in rows)))


def _score_band(name: str, rows: _CaseErrors) -> BandScore:
    """Return the statistics of the errors in a band of zenith angles, of all, or of those far from the track."""
    stated = rows.within[np.isfinite(rows.within[:, 0])]
    shares = [float(np.mean(stated[:, k])) if len(stated) else math.nan for k in range(len(SHARES))]
    return BandScore(
        band=name,
        n=len(rows.error_deg),
        median_deg=float(np.median(rows.error_deg)),
        p90_deg=float(np.quantile(rows.error_deg, 0.9)),
        median_px=float(np.median(rows.error_px)),
        p90_px=float(np.quantile(rows.error_px, 0.9)),
        within=(shares[0], shares[1], shares[2]),
    )


def as_object(one: Score) -> dict[str, Any]:
    """Return a score as JSON holds it; a value that is not a number is null."""

    def replace_nonfinite(value: object) -> object:
        if isinstance(value, float):
            return value if math.isfinite(value) else None
        if isinstance(value, dict):
            return {key: replace_nonfinite(held) for key, held in value.items()}
        return [replace_nonfinite(held) for held in value] if isinstance(value, list | tuple) else value

    stored = asdict(replace(one, findings=()))
    findings = [{**finding.as_json(), "text": finding.text} for finding in one.findings]
    return {key: replace_nonfinite(value) for key, value in stored.items()} | {"findings": findings}


def render_tables(scores: Sequence[Score]) -> str:
    """Return the tables of some entrants, in Markdown; the best of a band stands in bold, `*`: not as it was stated."""
    refused = "refused rightly, of | refused wrongly, of"
    parts = [f"| entrant | answered, of | {refused} | worse than none | beyond {FAR_SIGMAS:.0f} sigmas | lost | s |"]
    parts.append("|---|" + "--:|" * 7)
    for one in scores:
        answered = sum(case.answer == "answered" for case in one.cases)
        cells = [
            f"{answered}, {len(one.cases)}",
            f"{one.refused_rightly}, {one.unanswerable}",
            f"{one.refused_wrongly}, {one.answerable}",
            str(one.wrong),
            str(one.far),
            str(one.lost),
            _format_two_digits(one.processor_s),
        ]
        parts.append(f"| {one.entrant} | {' | '.join(cells)} |")
    for title, name in (("Median and 90 % of the error, degrees", "deg"), ("The same, px", "px")):
        parts += ["", f"{title}:", "", *_format_error_table(scores, name)]
    parts += ["", "Share of the truth within the stated 50, 68 and 95 %:", "", *_format_share_table(scores)]
    return "\n".join(parts) + "\n"


def _format_error_table(scores: Sequence[Score], unit: str) -> Iterator[str]:
    names = [band.band for band in scores[0].bands] if scores else []
    yield f"| entrant | {' | '.join(names)} |"
    yield f"|---|{'--:|' * len(names)}"
    columns = (f"median_{unit}", f"p90_{unit}")
    best = {name: [min(getattr(one.bands[k], name) for one in scores) for k in range(len(names))] for name in columns}
    for one in scores:
        cells = []
        for k, band in enumerate(one.bands):
            values = [(getattr(band, name), best[name][k]) for name in columns]
            shown = [
                _format_two_digits(value) if value > least else f"**{_format_two_digits(value)}**"
                for value, least in values
            ]
            cells.append(", ".join(shown))
        yield f"| {one.entrant} | {' | '.join(cells)} |"


def _format_share_table(scores: Sequence[Score]) -> Iterator[str]:
    names = [band.band for band in scores[0].bands] if scores else []
    yield f"| entrant | {' | '.join(names)} |"
    yield f"|---|{'--:|' * len(names)}"
    for one in scores:
        cells = [
            "not stated"
            if math.isnan(band.within[0])
            else ", ".join(f"{share:.2f}{'' if band.as_stated(k) else '*'}" for k, share in enumerate(band.within))
            for band in one.bands
        ]
        yield f"| {one.entrant} | {' | '.join(cells)} |"


def _format_two_digits(value: float) -> str:
    """Return two significant digits."""
    return "–" if not math.isfinite(value) else f"{value:.0f}" if value >= 9.95 else significant(value, 2)
