"""The dashboard shows the mask over the sky, the horizon with the sun's year, and the hours of sun that are lost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tests.imager.web.test_dashboard import browser, in_a_browser, is_accessible, opened, serving, words
from tests.imager.web.test_obstruction_routes import SIZE, day, learner, show

if TYPE_CHECKING:
    from obstruction_world import World
    from tests.fixtures.served import Make

    from sunarc.imager.archive.obstructions import ObstructionLearner

__all__ = ["day", "learner"]


@pytest.mark.browser
@in_a_browser
def test_the_horizon_is_on_the_page(
    make: Make, learner: ObstructionLearner, day: tuple[World, list[np.ndarray]], tmp_path: Path
) -> None:
    show(learner, day)
    noon = day[1][len(day[1]) // 2]
    cv2.imwrite(str(tmp_path / "sky_hdr.jpg"), np.clip(noon / np.quantile(noon, 0.95) * 220.0, 0, 255).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "drawn.png"), np.full((SIZE, SIZE), 255, np.uint8))
    made = make(
        image=tmp_path / "sky_hdr.jpg",
        history="filled",
        obstructions=learner,
        obstruction_mask=tmp_path / "drawn.png",
    )
    horizon = made.client.get("/v1/horizon").json()
    with serving(made) as address, browser() as chromium:
        for width, height in ((1440, 1000), (390, 844)):
            seen = opened(chromium, address, width=width, height=height)
            seen.page.wait_for_selector("#horizon-plot .hidden-sky", timeout=30_000, state="attached")
            seen.page.wait_for_selector("#mask[src]", timeout=30_000, state="visible")
            assert seen.page.locator("#horizon-plot .sun-way").count() == 3
            assert seen.page.locator("#lost-plot rect").count() == 12
            said = words(seen.page, "#horizon-sum")
            assert f"{sum(horizon['lost_h']):.0f} h" in said
            assert "agrees with 0 %" in said
            assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
            is_accessible(seen.page)
            seen.page.screenshot(path=tmp_path / f"horizon-{width}.png", full_page=True)
            seen.page.uncheck("#show-mask")
            seen.page.wait_for_selector("#mask", state="hidden")
            assert seen.complaints == []
