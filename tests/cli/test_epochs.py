"""Pose epochs on the command line: seen, and undone where a wrong clock began them."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.archive import make_empty

from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CameraRecord

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

FIRST = datetime(2013, 5, 13, 12, tzinfo=UTC)
WRONG = datetime(2100, 5, 13, 12, tzinfo=UTC)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(f'name = "roof"\nstate = "{tmp_path}"\n[site]\nlatitude = 36.6\nlongitude = -97.5\n')
    make_empty(tmp_path / "sunarc.sqlite")
    archive = open_archive(tmp_path / "sunarc.sqlite")
    archive.cameras.save(CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=0.0, width=8, height=6))
    archive.epochs.at("roof", FIRST, reason="first frame")
    archive.epochs.open("roof", at=WRONG, reason="bump")
    archive.close()
    return path


def test_a_wrong_epoch_is_closed_and_the_one_before_continues(sunarc: Sunarc, config: Path) -> None:
    assert "roof-2" in sunarc("epochs", "list", "--config", str(config)).out
    closed = sunarc("epochs", "close", "roof-2", "--reason", "clock ahead", "--config", str(config))
    assert closed.code == 0
    assert "roof-2 is closed; no calibration was served before it" in closed.out
    rows = json.loads(sunarc("epochs", "list", "--json", "--config", str(config)).out)
    assert [(row["id"], row["ended_at"], row["closed"]) for row in rows] == [
        ("roof-1", None, False),
        ("roof-2", WRONG.isoformat(), True),
    ]
    assert "closed as wrong" in sunarc("epochs", "list", "--config", str(config)).out


@pytest.mark.parametrize(("epoch", "words"), [("roof-1", "first pose epoch"), ("roof-7", "no open pose epoch")])
def test_what_cannot_be_closed_is_refused_with_the_reason(sunarc: Sunarc, config: Path, epoch: str, words: str) -> None:
    answer = sunarc("epochs", "close", epoch, "--config", str(config))
    assert answer.code == 2
    assert words in answer.err
