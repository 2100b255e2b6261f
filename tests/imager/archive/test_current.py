"""The archive holds the current calibration, and one camera's part of it."""

from __future__ import annotations

import ast
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from tests.imager.archive.test_calibrations import MAY, document

from sunarc.common.errors import InputError
from sunarc.imager.archive import calibrations
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.sky.site import Site

SITE = Site(latitude=36.604, longitude=-97.485, altitude=318.0)
SOURCES = Path(calibrations.__file__).parents[1]


def serve(archive: Archive, calibration_id: str, day: int) -> None:
    archive.calibrations.add(document(calibration_id, day=day))
    archive.calibrations.activate(calibration_id)


def test_the_current_calibration_is_read_again_only_after_a_write(
    archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    serve(archive, "a", 0)
    first = archive.calibrations.current("roof")
    monkeypatch.setattr(archive.calibrations, "_find_answering", None)
    assert archive.calibrations.current("roof") is first
    monkeypatch.undo()
    serve(archive, "b", 1)
    second = archive.calibrations.current("roof")
    assert second is not None
    assert second.id == "b"


def test_a_write_of_another_process_is_seen(archive: Archive, path: Path) -> None:
    assert archive.calibrations.current("roof") is None
    with open_archive(path) as other:
        serve(other, "a", 0)
    found = archive.calibrations.current("roof")
    assert found is not None
    assert found.id == "a"


@pytest.mark.usefixtures("path")  # PostgreSQL's number does not depend on the connection
def test_a_connection_that_is_opened_anew_counts_on(archive: Archive) -> None:
    before = archive.revision()
    archive.database._changes.close()
    assert archive.revision() > before


def test_a_document_is_parsed_once_and_a_failure_is_logged_once(
    archive: Archive, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    parsed: list[Any] = []

    def refuse(given: Any) -> None:  # noqa: ANN401 - a document
        parsed.append(given["id"])
        raise InputError(field="schema", problem="is of another version", remedy="upgrade")

    monkeypatch.setattr(calibrations, "from_document", refuse)
    serve(archive, "a", 0)
    for _ in range(3):
        assert archive.calibrations.current_model("roof") is None
        with pytest.raises(InputError) as caught:
            archive.calibrations.model("a")
        assert caught.value.field == "schema"
    assert parsed == ["a"]
    assert [record.levelname for record in caplog.records if record.name == calibrations.__name__] == ["WARNING"]


def test_without_a_calibration_there_is_no_model(archive: Archive) -> None:
    assert archive.calibrations.current_model("roof") is None


def test_a_camera_archive_asks_for_its_camera_alone(archive: Archive) -> None:
    serve(archive, "a", 0)
    roof, mast = (CameraArchive(archive, name=name, site=SITE) for name in ("roof", "mast"))
    assert roof.site_with_air_at(MAY) == SITE
    assert roof.archive.calibrations.current(mast.name) is None


def test_an_archive_is_closed_at_the_end_of_its_block(archive: Archive, path: Path) -> None:
    with open_archive(path) as other:
        witness = other._witness
    assert witness is not None
    with pytest.raises(sqlite3.ProgrammingError):
        witness.execute("SELECT 1")
    assert archive.calibrations.current("roof") is None


def test_every_command_opens_the_archive_in_a_with_statement() -> None:
    found = [
        f"{path.relative_to(SOURCES)}:{node.lineno}"
        for path in sorted(SOURCES.rglob("*.py"))
        if path.parts[-2] in {"cli", "commands", "archives"} or path.name == "checks.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Assign) and "open_archive(" in ast.unparse(node.value)
    ]
    assert found == []
