"""`sunarc hub`, and the settings that a hub takes."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.hub.feed_schema import feed_schema
from sunarc.hub.nightly_store import CrossCheck
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.feed_rows import Refusal
from sunarc.imager.settings.load import load_hub_settings

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[2]


@pytest.fixture
def config(tmp_path: Path) -> Path:
    make_empty(tmp_path / "sunarc.sqlite")
    path = tmp_path / "hub.toml"
    path.write_text(f'state = "{tmp_path}"\n[api]\nport = 8099\n')
    return path


def test_a_token_is_printed_once_and_its_digest_stored(sunarc: Sunarc, config: Path) -> None:
    options = ("--config", str(config))
    first = sunarc("hub", "token", "roof", *options).out.strip()
    second = sunarc("hub", "token", "roof", "--overlap", "0", *options).out.strip()
    assert len(first) >= 32
    assert first != second
    with open_hub_archive(config.parent / "sunarc.sqlite") as archive:
        tokens = archive.feeds.tokens("roof", now=NOW.replace(year=2100))
    assert tokens == (token_digest(second),)
    assert [sunarc("hub", "revoke", "roof", *options).code for _ in range(2)] == [0, 1]


def test_what_was_refused_is_listed_and_can_be_accepted(sunarc: Sunarc, config: Path) -> None:
    options = ("--config", str(config))
    assert sunarc("hub", "quarantine", *options).code == 0
    with open_hub_archive(config.parent / "sunarc.sqlite") as archive:
        refusal = Refusal(reason="second_installation", text="two")
        archive.feeds.refuse(camera="roof", installation="abc", refusal=refusal, now=NOW)
    found = sunarc("hub", "quarantine", "--json", *options)
    assert found.code == 1
    (row,) = json.loads(found.out)
    assert (row["camera"], row["installation"], row["reason"], row["n"]) == ("roof", "abc", "second_installation", 1)
    assert sunarc("hub", "accept", "roof", "abc", *options).code == 0
    assert sunarc("hub", "quarantine", *options).code == 0
    assert sunarc("hub", "resend", "roof", *options).code == 0
    assert sunarc("hub", "resend", "attic", *options).code == 2


def test_what_neighbours_show_is_printed(sunarc: Sunarc, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = ("--config", str(config))
    assert json.loads(sunarc("hub", "cross-checks", "--json", *options).out) == []
    made = CrossCheck(
        camera="roof",
        neighbours=("gate", "mast"),
        n_days=34,
        found=("clock",),
        agreeing=3,
        confidence=0.97,
        since=date(2026, 6, 26),
        clock_s=2.1,
        clock_sigma_s=0.2,
    )
    monkeypatch.setattr("sunarc.cli.hub.cross_check_fleet", lambda _archive, now: (made,) if now else ())
    found = sunarc("hub", "cross-checks", "--json", *options)
    assert found.code == 1
    (row,) = json.loads(found.out)
    assert (row["camera"], row["found"], row["clock_s"], row["since"]) == ("roof", ["clock"], 2.1, "2026-06-26")
    shown = sunarc("hub", "cross-checks", *options)
    assert shown.code == 1
    assert "2.1 ± 0.2" in shown.out
    assert "0.97" in shown.out


def test_a_hub_takes_its_own_settings_and_refuses_unknown_ones(sunarc: Sunarc, config: Path) -> None:
    settings = load_hub_settings(config)
    assert (settings.api.port, settings.archive) == (8099, config.parent / "sunarc.sqlite")
    config.write_text(config.read_text() + "[site]\nlatitude = 1.0\nlongitude = 2.0\n")  # an imager's file
    assert load_hub_settings(config).api.port == 8099
    config.write_text("stoer = 1\n")
    assert sunarc("hub", "quarantine", "--config", str(config)).code == 2
    assert sunarc("serve", "--role", "satellite").code == 2


def test_the_schema_that_is_published_is_the_one_that_is_checked_by(sunarc: Sunarc) -> None:
    published = json.loads((ROOT / "docs" / "feed.schema.json").read_text())
    assert published == feed_schema(head_revision()), "run: sunarc hub schema > docs/feed.schema.json"
    assert f"Sunarc-Revision: {head_revision()}\n" in (ROOT / "docs" / "feed.md").read_text()
    assert f'REVISION = "{head_revision()}"\n' in (ROOT / "deploy" / "hub" / "sender.py").read_text()
    assert json.loads(sunarc("hub", "schema").out) == published


def test_a_name_that_no_address_can_have_gets_no_token(sunarc: Sunarc, config: Path) -> None:
    assert sunarc("hub", "token", "a/b", "--config", str(config)).code == 2
