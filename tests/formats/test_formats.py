"""One record a format: the command, the service, its client and the documents name the same ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.formats.conftest import LENS, document_of

from sunarc.client.imager import Imager
from sunarc.common.findings import FindingError
from sunarc.formats import formats
from sunarc.formats.formats import FORMATS, SERVED, export, read_view
from sunarc.formats.tables import MAP_FORMATS

SMALL = replace(LENS, width=330, height=300, focal_length_px=(112.0, 112.3), principal_point_px=(164.2, 150.9))
DOCUMENTED = Path(__file__).resolve().parents[2] / "docs" / "formats.md"


def test_the_formats_with_a_media_type_are_served_and_files_are_called_differently() -> None:
    assert [name for name, one in FORMATS.items() if one.media_type is not None] == list(SERVED)
    assert {one.name for one in FORMATS.values()} == set(FORMATS)
    assert len({one.file for one in FORMATS.values()}) == len(FORMATS)
    assert {*MAP_FORMATS, *(f"map-{name}" for name in MAP_FORMATS)} < set(FORMATS)


def test_the_document_names_every_format() -> None:
    assert set(FORMATS) <= set(re.findall(r"`([a-z0-9-]+)`", DOCUMENTED.read_text(encoding="utf-8")))


def test_the_client_names_every_format_that_is_served() -> None:
    assert set(SERVED) - {"json"} <= set(re.findall(r"[a-z-]+", str(Imager.export.__doc__)))


@pytest.mark.parametrize("name", [name for name, one in FORMATS.items() if not one.media_type])
def test_the_file_is_called_as_the_table_says(name: str) -> None:
    made = export(document_of(SMALL), name)
    assert made.name in {"", FORMATS[name].file}


def test_an_unknown_format_is_an_error_with_its_code() -> None:
    with pytest.raises(FindingError) as refused:
        export(document_of(SMALL), "kalibr")
    assert (refused.value.finding.code, refused.value.finding.data["format"]) == ("format_unknown", "kalibr")
    with pytest.raises(FindingError) as refused:
        read_view(b"\x00\x01", name="file")
    assert refused.value.finding.code == "file_format_unknown"


@pytest.mark.parametrize("name", ["mrcal", "ros"])
def test_a_format_without_a_reader_is_an_error_with_its_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    content = export(document_of(SMALL), name).content
    table: dict[str, Any] = {**FORMATS, name: replace(FORMATS[name], read=None)}
    monkeypatch.setattr(formats, "FORMATS", table)
    with pytest.raises(FindingError) as refused:
        read_view(content, name="file")
    assert refused.value.finding.code == "format_without_reader"
    if FORMATS[name].media_type is None:  # the error of such a file is that of the file, read back
        with pytest.raises(FindingError):
            export(document_of(SMALL), name)
