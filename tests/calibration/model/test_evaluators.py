"""What a reader of the calibration document needs: evaluators of four languages, and the JSON Schema."""

from __future__ import annotations

import copy
import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema_rs
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import SGP, current_document, distinctive_calibration, small_camera

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.common.array_types import stacked
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document
from sunarc.optics.backward import back_project
from sunarc.optics.forward import project
from sunarc.optics.projections import PROJECTIONS
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]
DOCS = Path(__file__).parents[3] / "docs"
EVALUATORS = DOCS / "examples" / "evaluators"
SKY = hemisphere(40)
Own = list[tuple[Calibration, dict[str, Any]]]
"""Calibrations with their documents."""


def questions(made: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return directions, one of them beyond the model's angle, and pixels within the image."""
    pixels = project(made.camera, SKY)
    inside = np.all((pixels > 0.0) & (pixels < [1279.0, 959.0]), axis=-1)
    return np.concatenate([SKY[inside], [[0.0, 0.1, -1.0]]]), pixels[inside]


SHARE = 0.95


def compared(
    made: Calibration, found_pixels: FloatArray, found_directions: FloatArray, holding: FloatArray | None = None
) -> None:
    directions, pixels = questions(made)
    if holding is not None:
        factors = np.ones(len(pixels)) if made.mixture is None else made.mixture.sigma_factors(pixels, SHARE)
        np.testing.assert_allclose(holding, math.sqrt(-2.0 * math.log1p(-SHARE)) * factors, rtol=1e-3)
    np.testing.assert_allclose(found_pixels, project(made.camera, directions), atol=1e-8)
    assert np.isnan(found_pixels[-1]).all()
    np.testing.assert_allclose(found_directions, back_project(made.camera, made.backward, pixels), atol=1e-11)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_python_evaluator(projection: str, *, mirrored: bool) -> None:
    made = distinctive_calibration(projection, mirrored=mirrored)
    evaluator: dict[str, Any] = {"__name__": "evaluate_calibration"}
    exec((EVALUATORS / "evaluate_calibration.py").read_text(encoding="utf-8"), evaluator)  # noqa: S102 - ours
    directions, pixels = questions(made)
    read = current_document(made)
    compared(
        made,
        np.array([evaluator["project"](read, one) for one in directions]),
        np.array([evaluator["back_project"](read, one) for one in pixels]),
    )
    expected = project_with_covariance(made, directions[:3])[1].reshape(3, 4)
    found = np.array([evaluator["covariance"](read, one) for one in directions[:3]])
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)


@pytest.fixture(scope="module")
def own_documents() -> Own:
    """Return fits of a day without a field, of one beside a field, of no sightings, and of a day with a night."""
    truth = replace(small_camera(), max_angle=math.radians(95.0))
    times = 1_368_446_400.0 + np.arange(0.0, 40_000.0, 240.0)
    sun = sun_directions(times, SGP)
    noise = np.random.default_rng(3).normal(0.0, 0.05, (times.size, 2))
    pixels = project(truth, sun) + noise
    bent = pixels + 3.0 * np.sin(pixels[:, ::-1] / 60.0)
    day, beside = (Sightings.of(unix_s=times, pixels=one) for one in (pixels, bent))
    size = (truth.width, truth.height)
    seen = np.all(np.isfinite(project(truth, SKY)), axis=-1) & (SKY[:, 2] > 0.2)
    towards = np.tile(SKY[seen], (4, 1))
    stars = Sightings.of(
        unix_s=times[-1] + 36_000.0 + 60.0 * np.arange(len(towards), dtype=np.float64),
        pixels=project(truth, towards) + np.random.default_rng(4).normal(0.0, 0.05, (len(towards), 2)),
        sigma_px=np.full(len(towards), 0.05),
        directions=towards,
        kind=np.full(len(towards), Kind.STAR),
    )
    with_night = stacked([replace(day, sigma_px=np.full(times.size, 0.05)), stars])
    given = (day, beside, day.select(slice(0, 0)), with_night)
    fits = [calibrate(one, site=SGP, image_size=size) for one in given]
    return [(one, current_document(one)) for one in fits]


def test_the_documents_are_of_a_day_a_night_a_field_and_none(
    own_documents: Own,
) -> None:
    nights = [read["night"] is not None for _, read in own_documents]
    assert nights == [False, False, False, True]
    displaced = [bool(np.any(read["uncertainty"]["field"]["mean"])) for _, read in own_documents]
    assert displaced[:3] == [False, True, False]


def test_the_python_evaluator_reads_what_fits_write(own_documents: Own) -> None:
    evaluator: dict[str, Any] = {"__name__": "evaluate_calibration"}
    exec((EVALUATORS / "evaluate_calibration.py").read_text(encoding="utf-8"), evaluator)  # noqa: S102 - ours
    known = [len(read["uncertainty"]["field"]["known"]) for _, read in own_documents]
    assert min(known) == 0 < max(known)
    for fit, read in own_documents:
        directions = SKY[SKY[:, 2] > 0.3][:3]
        found = np.array([evaluator["covariance"](read, one) for one in directions])
        expected = project_with_covariance(fit, directions)[1].reshape(3, 4)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
        directions, pixels = questions(fit)
        gaussian = math.sqrt(-2.0 * math.log(0.5))
        factors = np.ones(len(pixels)) if fit.mixture is None else fit.mixture.sigma_factors(pixels, 0.5)
        holding = [evaluator["holding"](read, [*one, 0.5]) for one in pixels]
        np.testing.assert_allclose(np.ravel(holding), gaussian * factors, rtol=1e-3)
        compared(
            fit,
            np.array([evaluator["project"](read, one) for one in directions]),
            np.array([evaluator["back_project"](read, one) for one in pixels]),
        )


def test_the_python_evaluator_as_a_command(tmp_path: Path) -> None:
    made = distinctive_calibration()
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps(current_document(made)), encoding="utf-8")
    command = [
        sys.executable,
        str(EVALUATORS / "evaluate_calibration.py"),
        str(file),
        "project",
        "0.1",
        "0.2",
        "0.9747",
    ]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    np.testing.assert_allclose([float(n) for n in answer], project(made.camera, [0.1, 0.2, 0.9747]), atol=1e-8)


def numbers(read: dict[str, Any]) -> list[float]:
    """Return what the jq line in the C evaluator's head writes."""
    model, backward, field = read["model"], read["backward_model"], read["uncertainty"]["field"]
    mixture = read["uncertainty"].get("mixture") or {"shares": [1.0], "pixels_px": [[0.0, 0.0]], "scales": [[1.0]]}
    return [
        read["image"]["width"],
        int(read["image"]["mirrored"]),
        PROJECTIONS[model["projection"]].code,
        *model["focal_length_px"],
        model["skew_px"],
        *model["principal_point_px"],
        *model["rotation_cam_enu"],
        *model["translation"],
        *model["radial"],
        *model["decentering"],
        model["max_angle_deg"],
        *backward["radial"],
        *backward["decentering"],
        *field["center_px"],
        *field["half_px"],
        len(field["orders"]),
        *(order for pair in field["orders"] for order in pair),
        *(value for part in field["mean"] for value in part),
        *(len(mixture["shares"]), len(mixture["pixels_px"]), *mixture["shares"]),
        *(value for key in ("pixels_px", "scales") for place in mixture[key] for value in place),
    ]


def cases(own: Own, *, both_hands: bool = False) -> Own:
    """Return calibrations of all projections, mirrored by turns or both ways, and fits, with their documents."""
    drawn = [(name, k % 2 == 1) for k, name in enumerate(PROJECTIONS)]
    if both_hands:
        drawn += [(name, not mirrored) for name, mirrored in drawn]
    made = [distinctive_calibration(name, mirrored=mirrored) for name, mirrored in drawn]
    return [(one, current_document(one)) for one in made] + own


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_evaluator(tmp_path: Path, own_documents: Own) -> None:
    program, values = tmp_path / "evaluate", tmp_path / "calibration.txt"
    source = str(EVALUATORS / "evaluate_calibration.c")
    subprocess.run(["cc", "-O2", "-Wall", "-Wextra", "-Werror", source, "-lm", "-o", program], check=True)
    for made, read in cases(own_documents, both_hands=True):
        values.write_text("\n".join(repr(float(n)) for n in numbers(read)), encoding="utf-8")
        directions, pixels = questions(made)
        asked = [("d", *one) for one in directions] + [("p", *one) for one in pixels]
        asked += [("h", *one, SHARE) for one in pixels]
        text = "\n".join(" ".join(map(str, one)) for one in asked)
        answer = subprocess.run([program, values], input=text, capture_output=True, text=True, check=True)
        rows = [[float(n) for n in line.split()] for line in answer.stdout.splitlines()]
        first, last = len(directions), len(directions) + len(pixels)
        compared(made, np.array(rows[:first]), np.array(rows[first:last]), np.ravel(rows[last:]))


@pytest.mark.skipif(shutil.which("jq") is None or shutil.which("cc") is None, reason="no jq, or no C compiler")
def test_the_line_of_jq_in_the_c_evaluator_writes_its_numbers(tmp_path: Path) -> None:
    head = (EVALUATORS / "evaluate_calibration.c").read_text(encoding="utf-8").split("\n\n")[1]
    (tmp_path / "calibration.json").write_text(
        json.dumps(current_document(distinctive_calibration())), encoding="utf-8"
    )
    subprocess.run(["sh", "-c", head], cwd=tmp_path, check=True)
    written = [float(n) for n in (tmp_path / "calibration.txt").read_text(encoding="utf-8").split()]
    np.testing.assert_allclose(written, numbers(current_document(distinctive_calibration())), rtol=1e-15)
    (tmp_path / "calibration.txt").write_text("1 2 3", encoding="utf-8")
    program = tmp_path / "evaluate"
    subprocess.run(["cc", str(EVALUATORS / "evaluate_calibration.c"), "-lm", "-o", program], check=True)
    assert subprocess.run([program, "calibration.txt"], cwd=tmp_path, capture_output=True, check=False).returncode == 2


OCTAVE = """
addpath(FOLDER);
for k = 1:COUNT
  document = jsondecode(fileread(sprintf('%d.json', k)));
  asked = jsondecode(fileread(sprintf('%d.asked.json', k)));
  pixels = []; directions = []; sigmas = [];
  for i = 1:size(asked.directions, 1)
    pixels(i, :) = evaluate_calibration(document, 'project', asked.directions(i, :)');
  end
  for i = 1:size(asked.pixels, 1)
    directions(i, :) = evaluate_calibration(document, 'back-project', asked.pixels(i, :)');
    sigmas(i, 1) = evaluate_calibration(document, 'holding', [asked.pixels(i, :)'; SHARE]);
  end
  dlmwrite(sprintf('%d.pixels', k), pixels, 'precision', 17);
  dlmwrite(sprintf('%d.directions', k), directions, 'precision', 17);
  dlmwrite(sprintf('%d.sigmas', k), sigmas, 'precision', 17);
end
"""

R = """
source(file.path(FOLDER, 'evaluate_calibration.R'))
for (k in 1:COUNT) {
  document <- jsonlite::fromJSON(sprintf('%d.json', k))
  asked <- jsonlite::fromJSON(sprintf('%d.asked.json', k))
  pixels <- t(apply(asked$directions, 1, function(one) project(document, one)))
  directions <- t(apply(asked$pixels, 1, function(one) back_project(document, one)))
  sigmas <- apply(asked$pixels, 1, function(one) holding(document, one, SHARE))
  for (what in c('pixels', 'directions', 'sigmas'))
    write.table(format(get(what), digits = 17), sprintf('%d.%s', k, what), sep = ',', quote = FALSE,
                row.names = FALSE, col.names = FALSE)
}
"""


def in_another_language(tmp_path: Path, own: Own, command: list[str], script: str) -> None:
    """Ask an evaluator about all documents in one run of its interpreter."""
    asked_about = cases(own)
    for k, (made, read) in enumerate(asked_about, 1):
        directions, pixels = questions(made)
        (tmp_path / f"{k}.json").write_text(json.dumps(read), encoding="utf-8")
        asked = {"directions": directions.tolist(), "pixels": pixels.tolist()}
        (tmp_path / f"{k}.asked.json").write_text(json.dumps(asked), encoding="utf-8")
    filled = script.replace("FOLDER", f"'{EVALUATORS}'").replace("COUNT", str(len(asked_about)))
    filled = filled.replace("SHARE", str(SHARE))
    done = subprocess.run([*command, filled], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120.0)
    assert done.returncode == 0, done.stderr
    for k, (made, _) in enumerate(asked_about, 1):
        names = ("pixels", "directions", "sigmas")
        found = (np.genfromtxt(tmp_path / f"{k}.{name}", delimiter=",") for name in names)
        compared(made, *found)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed: apt-get install octave")
def test_the_octave_evaluator(tmp_path: Path, own_documents: Own) -> None:
    in_another_language(tmp_path, own_documents, ["octave-cli", "--no-gui", "--quiet", "--eval"], OCTAVE)


@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed: apt-get install r-cran-jsonlite")
def test_the_r_evaluator(tmp_path: Path, own_documents: Own) -> None:
    in_another_language(tmp_path, own_documents, ["Rscript", "--vanilla", "-e"], R)


@pytest.fixture(scope="module")
def validator() -> Any:  # noqa: ANN401 - the library's
    schema = json.loads((DOCS / "calibration.schema.json").read_text(encoding="utf-8"))
    jsonschema_rs.meta.validate(schema)
    return jsonschema_rs.validator_for(schema)


def keys(node: object, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the path of every key, at any depth."""
    if not isinstance(node, dict):
        return []
    return [one for key, value in node.items() for one in [(*path, key), *keys(value, (*path, key))]]


def changed(read: dict[str, Any], path: tuple[str, ...], value: object) -> dict[str, Any]:
    """Return a copy with another value at a path; without the key where the value is Ellipsis."""
    result = copy.deepcopy(read)
    at = result
    for key in path[:-1]:
        at = at[key]
    if value is Ellipsis:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return result


def test_documents_keep_to_the_schema(validator: Any) -> None:  # noqa: ANN401 - the library's
    for projection in PROJECTIONS:
        validator.validate(current_document(distinctive_calibration(projection)))


def test_whatever_the_schema_lets_pass_can_be_read_and_what_it_refuses_of_the_model_cannot(
    validator: Any,  # noqa: ANN401 - the library's
) -> None:
    read = current_document(distinctive_calibration())
    refused = 0
    for path in keys(read):
        for value in (..., "text", [1.0], None):
            other = changed(read, path, value)
            valid = validator.is_valid(other)
            try:
                from_document(other)
            except InputError:
                assert not valid, (path, value)
                refused += 1
    assert refused > 60
    for path in (("model",), ("model", "radial"), ("image", "width"), ("uncertainty", "covariance"), ("schema",)):
        assert not validator.is_valid(changed(read, path, ...)), path
