"""The notebook of the examples: its cells run in their order, and say what the service says."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import LENS, NOON, archives, make
from tests.imager.web.test_event_stream import serving

from sunarc.imager.archive.images import ImageStore
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

__all__ = ["archives", "make"]

NOTEBOOK = Path(__file__).parents[2] / "docs" / "examples" / "sky.ipynb"


@pytest.fixture(scope="module")
def cells() -> list[dict[str, Any]]:
    notebook = json.loads(NOTEBOOK.read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    return list(notebook["cells"])


def test_the_notebook_is_stored_without_outputs(cells: list[dict[str, Any]]) -> None:
    ids = [cell["id"] for cell in cells]
    assert len(set(ids)) == len(ids) > 8
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all((cell["outputs"], cell["execution_count"]) == ([], None) for cell in code)


def test_its_cells_run_in_their_order(
    cells: list[dict[str, Any]], make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xarray")
    pytest.importorskip("matplotlib").use("Agg")
    store = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    y, x = np.mgrid[0 : LENS.height, 0 : LENS.width]
    sun = project(LENS, sun_directions(NOON.timestamp(), SITE))
    light = 1000.0 + 50_000.0 * np.exp(-np.hypot(x - sun[0], y - sun[1]) / 30.0)
    store.write(NOON, cv2.imencode(".png", light.astype(np.uint16))[1].tobytes(), kind="hdr.png")
    made: Made = make(history="filled", images=store)
    names: dict[str, Any] = {"__name__": "__main__"}
    said = io.StringIO()
    with serving(made) as address, redirect_stdout(said):
        monkeypatch.setenv("SUNARC_ADDRESS", address.rstrip("/"))
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # noqa: S102 - of this repository
    almucantar = names["almucantar"]
    assert float(almucantar[np.argmin(np.abs(names["from_sun_deg"]))]) == np.nanmax(almucantar) > 20_000.0
    at = names["sky"].sel(x=900, y=700)
    assert float(at.zenith) == pytest.approx(
        np.degrees(np.arccos(unproject(LENS, np.array([900.0, 700.0]))[2])), abs=1e-3
    )
    assert f"latitude {SITE.latitude:.1f}" in said.getvalue()
