"""What asi_core's loader reads of a camera: one file for each time that it stood still, with its mask and matrices.

Reference: `load_camera_data` of https://github.com/DLR-SF/Sky-Imaging, which reads every YAML file of a folder.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from sunarc.calibration.model.direction_table import lookup
from sunarc.calibration.model.document import from_document
from sunarc.calibration.model.maps import back_projection_map
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError
from sunarc.exports.asi_core import asi_core_yaml, mask_files, matrix_files
from sunarc.exports.comparison import compare
from sunarc.exports.discovery import FAR_FUTURE, FAR_PAST
from sunarc.exports.exported import Exported, notes_of
from sunarc.exports.ocam import ocam_model, ocam_view
from sunarc.exports.view import camera_view

Document = Mapping[str, Any]

_RANK = {"candidate": 1, "retired": 2, "current": 3}
"""Which of an epoch's calibrations is chosen: the highest, then the newest."""


def asi_core_file(calibration: Calibration, document: Document, *, with_matrices: bool = False) -> Exported:
    """Return the camera file of a calibration, with its mask and, where they are wanted, its matrices beside it."""
    camera, model = calibration.camera, ocam_model(calibration.camera, cubic=True)
    error = compare(camera_view(camera), ocam_view("asi-core", model, size=(camera.width, camera.height)))
    mounted = document["valid_from"] or FAR_PAST
    name, time = _plain(document["camera"]), re.sub(r"[^0-9]", "", mounted)[:14]
    found = back_projection_map(lookup(calibration))
    masks = mask_files(found, stem=f"{name}_{time}")
    matrices = matrix_files(found, camera=name, time=time) if with_matrices else {}
    notes = [
        *notes_of(document),
        f"this model {error}",
        "four coefficients can do no more: the matrices of azimuth and elevation of a set are exact",
        "asi_core's own azimuth matrix is counted in radians counter-clockwise from east: it is pi/2 - azimuth",
        "its object coordinates are (north, east, up); its x_center is the row, its y_center the column",
    ]
    site = {
        "camera_name": str(document["camera"]),
        "camera_mask_file": min(masks),
        "celestial_coordinate_masks": min(matrices, default=""),
        "mounted": mounted,
        "demounted": document["valid_until"] or FAR_FUTURE,
        **{name: float(document["site"][name]) for name in ("latitude", "longitude", "altitude")},
    }
    content = asi_core_yaml(model, width=camera.width, height=camera.height, camera=site, notes=notes)
    return Exported(
        content=content,
        error=str(error),
        difference=error.total,
        name=f"{name}_{time}.yaml",
        beside=masks | matrices,
    )


def asi_core_set(documents: Sequence[Document]) -> list[Exported]:
    """Return one camera file for each pose epoch of each camera, with its mask and matrices, in order of time.

    An epoch's file is that of its current calibration, or the last retired one; refused ones count only where there is
    nothing else. It is mounted from the start of the epoch to that of the next one, so that no two overlap.

    Raises
    ------
    InputError
        There is no document, or one is none.
    """
    if not documents:
        raise InputError(field="calibrations", problem="there is none", remedy="name calibration documents")
    calibrations = {id(document): from_document(document) for document in documents}
    made = []
    for camera in sorted({str(document["camera"]) for document in documents}):
        chosen = _epochs([document for document in documents if document["camera"] == camera])
        made += [asi_core_file(calibrations[key], document, with_matrices=True) for key, document in chosen]
    return made


def _epochs(documents: Sequence[Document]) -> list[tuple[int, Document]]:
    """Return the chosen document of each epoch of a camera with the epoch's own validity, and the identity it had."""
    usable = [document for document in documents if document["state"] != "refused"] or list(documents)
    epochs: dict[str, list[Document]] = {}
    for document in usable:
        epochs.setdefault(str(document["pose_epoch"]), []).append(document)
    starts = sorted((min(document["valid_from"] or "" for document in group), name) for name, group in epochs.items())
    chosen: list[tuple[int, Document]] = []
    for (start, name), following in pairwise([*starts, ("", "")]):
        group = epochs[name]
        best = max(group, key=lambda one: (_RANK.get(one["state"], 0), one["created_at"]))
        ends = [document["valid_until"] for document in group]
        last = None if None in ends else max(ends)
        validity = {"valid_from": start or None, "valid_until": following[0] or last}
        chosen.append((id(best), {**best, **validity}))
    return chosen


def _plain(name: object) -> str:
    """Return a name that is a plain file name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", str(name))
