"""Which frames of a bracket are kept where the camera's true exposures are not the stated ones."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.common.errors import CameraLostError, ExposureMismatchError
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imager.workers.exposures import ExposureSequence

if TYPE_CHECKING:
    from .conftest import FakeCamera

SKY = np.linspace(0.0, 40.0, 120 * 160).reshape(120, 160)
"""Counts for each 1000 µs of exposure: 400 µs can be compared with 3000 µs, 1 µs cannot."""
NORMAL_US, SHORT_US, TELLING_US = 3_000.0, 1.0, 400.0


@dataclass
class LitCamera:
    """Answers with the sky under the stated exposure times the factors that it is given, in turn."""

    black: FakeCamera
    factors: list[float] = field(default_factory=list)
    distrusted: int = 0

    def expose(self, exposure_us: float) -> Frame:
        factor = self.factors.pop(0) if self.factors else 1.0
        image = np.minimum(np.round(100.0 + SKY * exposure_us * factor / 1000.0), 4095.0).astype(np.uint16)
        return replace(self.black.expose(exposure_us), image=image)

    def distrust(self) -> None:
        self.distrusted += 1


@pytest.fixture
def lit(camera: FakeCamera) -> LitCamera:
    return LitCamera(camera)


def taken(
    lit: LitCamera,
    board: StatusRegistry,
    *factors: float,
    order: tuple[float, ...],
    before: frozenset[float] = frozenset(),
) -> list[float]:
    """Return which exposures of a bracket are kept, their true lengths being these times the stated ones."""
    normal = lit.expose(NORMAL_US)
    lit.factors = list(factors)
    sequence = ExposureSequence(
        camera=lit,  # type: ignore[arg-type]
        has_time=lambda: True,
        report=CaptureReport(board, name="capture"),
        received=lambda _: None,
    )
    frames, refused = sequence.take_bracket(order, [normal], refused_before_us=before)
    assert refused <= set(order)
    return [frame.exposure_us for frame in frames]


@pytest.mark.parametrize("order", [(SHORT_US, TELLING_US), (TELLING_US, SHORT_US)])
def test_a_bracket_that_agrees_is_kept(order: tuple[float, ...], lit: LitCamera, board: StatusRegistry) -> None:
    assert taken(lit, board, order=order) == list(order)
    assert lit.distrusted == 0


def test_a_frame_too_dark_to_compare_goes_with_the_doubted_one_after_it(lit: LitCamera, board: StatusRegistry) -> None:
    # both under a quarter of their exposure; the second attempt of the later one is right again
    assert taken(lit, board, 0.25, 0.25, 1.0, order=(SHORT_US, TELLING_US)) == [TELLING_US]
    assert lit.distrusted == 1


@pytest.mark.parametrize("order", [(SHORT_US, TELLING_US), (TELLING_US, SHORT_US)])
def test_nothing_of_a_bracket_is_kept_whose_exposures_stay_wrong(
    order: tuple[float, ...], lit: LitCamera, board: StatusRegistry
) -> None:
    assert taken(lit, board, *[0.25] * 6, order=order) == []
    assert lit.distrusted == 2


def test_what_comes_after_a_second_attempt_that_agrees_is_kept(lit: LitCamera, board: StatusRegistry) -> None:
    assert taken(lit, board, 4.0, 1.0, 1.0, order=(TELLING_US, SHORT_US)) == [TELLING_US, SHORT_US]


LONGER_US = 1200.0


@pytest.mark.parametrize("order", [(TELLING_US, LONGER_US), (LONGER_US, TELLING_US)])
def test_a_doubt_about_a_shorter_frame_leaves_the_longer_ones(
    order: tuple[float, ...], lit: LitCamera, board: StatusRegistry
) -> None:
    factors = [f for e in order for f in ([1.0] if e == LONGER_US else [4.0, 4.0])]
    assert taken(lit, board, *factors, order=order) == [LONGER_US]
    assert lit.distrusted == 2


@pytest.mark.parametrize("order", [(SHORT_US, TELLING_US), (TELLING_US, SHORT_US)])
def test_an_exposure_that_is_always_refused_does_not_take_the_others_with_it(
    order: tuple[float, ...], lit: LitCamera, board: StatusRegistry
) -> None:
    always = frozenset({TELLING_US})
    factors = [f for e in order for f in ([1.0] if e == SHORT_US else [4.0, 4.0])]
    assert taken(lit, board, *factors, order=order, before=always) == [SHORT_US]


def test_frames_that_never_agree_are_no_lost_cable(lit: LitCamera, board: StatusRegistry) -> None:
    lit.factors = [1.0, 0.25] * 6
    report = CaptureReport(board, name="capture")
    sequence = ExposureSequence(
        camera=lit,  # type: ignore[arg-type]
        has_time=lambda: True,
        report=report,
        received=lambda _: None,
    )
    with pytest.raises(ExposureMismatchError) as raised:
        sequence.take_agreeing((NORMAL_US, TELLING_US))
    report.lost(raised.value)
    codes = {reason.code for reason in board.snapshot().reasons}
    assert "exposures_contradicted" in codes
    assert "camera_lost" not in codes
    report.lost(CameraLostError("the cable is cut"))
    codes = {reason.code for reason in board.snapshot().reasons}
    assert "camera_lost" in codes
    assert "exposures_contradicted" not in codes
