"""The benchmark's peers answer a plain case well; a published track is read, and nothing in its file is run."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import benchmark_entrants
import benchmark_real
import numpy as np
import pytest
from benchmark_entrants import ENTRANTS, Entrant, entered, possible

from sunarc.lab.studies.benchmark_cases import benchmark_case
from sunarc.lab.studies.benchmark_files import read_entry, read_truth, write_round
from sunarc.lab.studies.benchmark_scores import score
from sunarc.sky.sun import sun_directions

PLAIN = [one for one in ENTRANTS if not one.needs]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a round of a clear case with stars all over the sky, and of twenty minutes of sun."""
    made = tmp_path_factory.mktemp("round")
    cases = [benchmark_case(number, seed=3, night=number == 0) for number in (0, 7)]
    write_round(cases, folder=made, part="night", seed=3)
    return made


@pytest.mark.parametrize("entrant", PLAIN, ids=[one.name for one in PLAIN])
def test_a_peer_is_right_where_stars_are_all_over_the_sky(folder: Path, tmp_path: Path, entrant: Entrant) -> None:
    entered(entrant, None, [folder / "cases" / "n000"], tmp_path)
    truths = {"n000": read_truth(folder / "truth")["n000"]}
    found = score(entrant.name, truths, read_entry(tmp_path, truths))
    assert (found.lost, found.wrong, found.findings) == (0, 0, ())
    assert found.bands[-1].median_deg < 0.1
    assert found.bands[-1].within[2] > 0.1


def test_a_peer_whose_library_is_missing_is_skipped_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    absent = Entrant("absent", "no_such_module", PLAIN[0].prepared)
    monkeypatch.setattr(benchmark_entrants, "ENTRANTS", (absent, PLAIN[0]))
    assert [entrant.name for entrant, _ in possible([])] == [PLAIN[0].name]
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[:2] for line in printed if "absent" in line] == [["absent", "skipped"]]
    assert len(printed) == 1 + len(benchmark_entrants.ABSENT)


class Authors:
    """What a file may hold: angles and pixels, or a command."""

    def __init__(self, **held: object) -> None:
        self.__dict__.update(held)


class Command:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("command_ran"),)


def written(folder: Path, *, beside: object = None) -> None:
    """Write a track as its authors did: y from the lower edge, the sun of every second minute."""
    series = benchmark_real.SERIES[0]
    minutes = series.day_unix_s + 60.0 * np.arange(480.0, 900.0, 2.0)
    east, north, up = sun_directions(minutes, series.site).T
    zenith, azimuth = np.arccos(up), np.arctan2(east, north) % (2.0 * np.pi)
    x, y = 960.0 + 600.0 * zenith * np.sin(azimuth), 960.0 + 600.0 * zenith * np.cos(azimuth)
    pixels, sun = Authors(_x=x, _y=y, methods=beside), Authors(_elevation=zenith, _azimuth=azimuth)
    (folder / series.pixels).write_bytes(pickle.dumps(pixels))
    (folder / series.angles).write_bytes(pickle.dumps(sun))


@pytest.mark.parametrize("beside", [None, Command()])
def test_a_published_track_is_read_and_nothing_in_its_file_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beside: object
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path, beside=beside)
    track = benchmark_real.track_of(benchmark_real.SERIES[0], None, tmp_path.as_uri() + "/")
    assert not isinstance(track, str)
    assert np.all(np.diff(track.unix_s) == 120.0)
    assert not (tmp_path / "command_ran").exists()
    cases = list(benchmark_real.cases_of(benchmark_real.SERIES[0], track))
    assert [truth.condition for _, truth in cases] == ["morning", "afternoon", "hours"]
    for case, truth in cases:
        assert len(truth.pixels) + len(case.sightings) == len(track)
        # 600 px a radian of an equidistant lens, along its radius and more across
        assert np.all((truth.px_per_deg[:, 0, 0] > 10.0) & (truth.px_per_deg[:, 0, 0] < 17.0))


def test_a_track_that_is_not_to_be_had_says_why(tmp_path: Path) -> None:
    for folder, base in ((tmp_path, None), (None, tmp_path.as_uri() + "/")):
        assert isinstance(benchmark_real.track_of(benchmark_real.SERIES[0], folder, base), str)
