"""The document's field: which waves travel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunarc.calibration.model.document import _field
from sunarc.calibration.model.residual_field import Field, wave_basis


@pytest.fixture
def field() -> Field:
    basis = wave_basis(width=640, height=480, shortest_px=160.0, longest_px=160.0)
    cross = np.zeros((2, 3, len(basis.orders)))
    cross[0, 0, :3] = 1.0, 2e-5, 5e-6
    cross[1, 1, 4:6] = 3e-9, -1e-7  # a parameter of smaller unit has a scale of its own
    return Field(amplitude_px=0.3, length_px=160.0, basis=basis, cross=cross)


def test_waves_travel_that_share_a_hundred_thousandth_with_some_parameter(field: Field) -> None:
    document = _field(field)
    travelling = [0, 1, 4, 5]
    assert document["orders"] == field.basis.orders[travelling].tolist()
    np.testing.assert_allclose(document["cross"], field.cross[:, :, travelling], rtol=1e-7)


def test_a_field_that_hangs_together_with_nothing_or_is_none_has_no_waves(field: Field) -> None:
    assert _field(replace(field, cross=0.0 * field.cross))["orders"] == []
    assert _field(replace(field, amplitude_px=0.0))["orders"] == []
