"""A displacement beside the lens reaches other formats: those that can follow it do, the others are nearer with it."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.formats.conftest import LENS, document_of

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import FORMATS, export, read_view
from sunarc.optics.displacement import wave_basis
from sunarc.optics.forward import project


def displaced_document(amplitude_px: float) -> dict[str, object]:
    """Return a document whose image is displaced by a smooth field of some amplitude."""
    basis = wave_basis(width=LENS.width, height=LENS.height, shortest_px=420.0, longest_px=420.0)
    rng = np.random.default_rng(3)
    mean = amplitude_px * np.sqrt(basis.variances(length_px=420.0)) * rng.standard_normal((2, len(basis.orders)))
    return dict(json.loads(json.dumps(document_of(replace(LENS, displacement=basis.displacement(mean))))))


@pytest.mark.parametrize(("form", "most_px"), [("json", 1e-6), ("mrcal", 0.02), ("opencv", 0.25), ("ocamcalib", 0.35)])
def test_an_export_follows_the_displacement(form: str, most_px: float) -> None:
    document = displaced_document(0.3)
    view = read_view(export(document, form).content, name=FORMATS[form].file)
    sky = hemisphere(400)
    sky = sky[sky[:, 2] > math.cos(math.radians(80.0))]
    seen = project(from_document(document).camera, sky)
    alone = project(LENS, sky)
    off = float(np.sqrt(np.mean(np.sum((view.project(sky) - seen) ** 2, axis=-1))))
    displaced = float(np.sqrt(np.mean(np.sum((alone - seen) ** 2, axis=-1))))
    assert 0.2 < displaced < 0.7
    assert off < most_px
    assert off < displaced
