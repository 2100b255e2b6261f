"""The ledger gives back what it was given, to the last digit, and replaces what is done again."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.postgresql import Server, postgresql

from sunarc.archives.ledger import ImageId, KeptMask, Known, Ledger, content_key
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.detection.values import Detection
from sunarc.sky.site import Site
from sunarc.sources.look import code_hash, pack_mask, software

__all__ = ["postgresql"]

ONE, OTHER = ImageId("a.zip", "1.jpg", 0), ImageId("a.zip", "2.jpg", 7)
SUN = Detection(
    method="paper",
    accepted=True,
    verdict="clear",
    findings=(Finding("blob_found", {"n": 3, "share": 0.1}),),
    x_px=1.0 / 3.0,
    y_px=float(np.float64(2.0) ** 0.5),
    sigma_px=0.1,
    saturated_px=12,
)
REFUSED = Finding("file_truncated")


def ledger_in(folder: Path) -> Ledger:
    return Ledger(f"sqlite:///{folder / 'ledger.sqlite'}")


def test_answers_come_back_as_they_were(tmp_path: Path) -> None:
    with ledger_in(tmp_path) as ledger:
        ledger.store("roof", 1, [(ONE, Known("k1", SUN)), (OTHER, Known("k2", REFUSED))], version="1")
    with ledger_in(tmp_path) as ledger:
        assert dict(ledger.answers("roof", pass_number=1)) == {ONE: Known("k1", SUN), OTHER: Known("k2", REFUSED)}
        assert dict(ledger.answers("roof", pass_number=2)) == dict(ledger.answers("mast", pass_number=1)) == {}
        assert ledger.count_finished_chunks() == 1


def test_a_ledger_in_postgresql_gives_the_same_answers_and_mask(postgresql: Server) -> None:
    url = postgresql.new_database(template="template0")
    mask = pack_mask(np.eye(20, dtype=np.bool_))
    address = url.render_as_string(hide_password=False)
    try:
        with Ledger(address) as ledger:
            ledger.store("roof", 1, [(ONE, Known("k1", REFUSED)), (OTHER, Known("k2", REFUSED))], version="1")
            ledger.store("roof", 1, [(ONE, Known("k3", SUN))], version="1")
            ledger.keep_mask("roof", mask, version="1")
            ledger.keep_result("exports " + 500 * "x", "k", {"sun": SUN})
        with Ledger(address) as ledger:
            assert dict(ledger.answers("roof", pass_number=1)) == {ONE: Known("k3", SUN), OTHER: Known("k2", REFUSED)}
            assert ledger.mask("roof", version="1") == KeptMask(mask)
            assert ledger.result("exports " + 500 * "x", "k") == {"sun": SUN}
            assert ledger.count_finished_chunks() == 2
    finally:
        postgresql.drop(url)


def test_what_an_answer_rests_on_is_stored_with_it(tmp_path: Path) -> None:
    known = Known("k1", SUN, "a" * 24, "b" * 32)
    with ledger_in(tmp_path) as ledger:
        ledger.store("roof", 1, [(ONE, known)], version="1")
        assert dict(ledger.answers("roof", pass_number=1)) == {ONE: known}


def test_an_answer_that_is_stored_again_replaces_the_former_one_of_its_pass(tmp_path: Path) -> None:
    with ledger_in(tmp_path) as ledger:
        ledger.store("roof", 1, [(ONE, Known("k1", SUN)), (OTHER, Known("k1", SUN))], version="1")
        ledger.store("roof", 2, [(ONE, Known("k1", SUN))], version="1")
        ledger.store("roof", 1, [(ONE, Known("k2", REFUSED))], version="1")
        assert dict(ledger.answers("roof", pass_number=1)) == {ONE: Known("k2", REFUSED), OTHER: Known("k1", SUN)}
        assert dict(ledger.answers("roof", pass_number=2)) == {ONE: Known("k1", SUN)}


def test_numbers_of_numpy_are_stored_as_numbers(tmp_path: Path) -> None:
    found = Detection(
        method="disc",
        accepted=False,
        verdict="hidden",
        findings=(),
        x_px=np.float64(1.5),
        saturated_px=np.int64(3),  # type: ignore[arg-type]
    )
    with ledger_in(tmp_path) as ledger:
        ledger.store("roof", 1, [(ONE, Known("k", found))], version="1")
        stored = dict(ledger.answers("roof", pass_number=1))[ONE].found
    assert isinstance(stored, Detection)
    assert (stored.x_px, stored.saturated_px) == (1.5, 3)


def test_a_mask_is_kept_for_a_version(tmp_path: Path) -> None:
    mask = pack_mask(np.eye(20, dtype=np.bool_))
    with ledger_in(tmp_path) as ledger:
        assert ledger.mask("roof", version="1") is None
        ledger.keep_mask("roof", mask, version="1")
        ledger.keep_mask("mast", None, version="1")
        assert ledger.mask("roof", version="1") == KeptMask(mask)
        assert ledger.mask("mast", version="1") == KeptMask(None)
        assert ledger.mask("roof", version="2") is None


def test_a_chunk_is_stored_whole_or_not_at_all(tmp_path: Path) -> None:
    def broken() -> object:
        yield ONE, Known("k", SUN)
        raise RuntimeError

    with ledger_in(tmp_path) as ledger:
        with pytest.raises(RuntimeError):
            ledger.store("roof", 1, broken(), version="1")  # type: ignore[arg-type]
        assert dict(ledger.answers("roof", pass_number=1)) == {}


def test_a_file_that_is_no_ledger_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ledger.sqlite").write_bytes(b"no database at all, but long enough to be one" * 50)
    with pytest.raises(OutsideError):
        ledger_in(tmp_path)


def test_a_result_holds_while_it_is_made_of_the_same(tmp_path: Path) -> None:
    site = Site(latitude=1.0, longitude=2.0, altitude=3.0)

    def doubled(given: tuple[Site, FloatArray]) -> FloatArray:
        return 2.0 * given[1]

    def at_once(run: Any, given: Any) -> list[Any]:  # noqa: ANN401 - as `ParallelMap`
        made.append(len(given))
        return [run(one) for one in given]

    made: list[int] = []
    for x, n in ((1.0, [1]), (1.0, []), (2.0, [1]), (1.0, [1])):
        made.clear()
        with ledger_in(tmp_path) as ledger:
            given = [(site, np.full(3, x))]
            (found,) = ledger.each(at_once, doubled, given, names=["roof"])
        assert made == n
        assert found is not None
        assert found.tolist() == [2.0 * x] * 3


def test_a_hash_of_content_differs_with_each_part_and_not_with_the_process() -> None:
    values = [
        (1.0,), (1,), [1.0], ((1.0,),), (1.0, None), ("1.0",), {"a": 1.0}, {"a": 2.0}, np.array([1.0]),
        np.array([[1.0]]), np.array([1], np.int64), SUN, replace(SUN, x_px=0.5), ("a", "b"), ("ab",),
    ]  # fmt: skip
    assert len({content_key(one) for one in values}) == len(values)
    assert content_key({"a": 1, "b": 2}) == content_key({"b": 2, "a": 1})
    assert content_key((np.float64(0.1),)) == content_key((0.1,))
    assert content_key(SUN) == content_key(pickle.loads(pickle.dumps(SUN)))  # noqa: S301 - its own
    with pytest.raises(TypeError):
        content_key(object())


class _Runs:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("ran"),))


def test_a_ledger_that_others_wrote_runs_nothing_of_theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with ledger_in(tmp_path) as ledger:
        ledger.keep_result("fits roof", "k", _Runs())
        assert ledger.result("fits roof", "k") is None
        ledger.keep_result("fits roof", "k", {"sun": SUN, "at": np.arange(3.0)})
        assert ledger.result("fits roof", "k")["sun"] == SUN
        assert ledger.result("fits roof", "other") is None
    assert not (tmp_path / "ran").exists()


def test_the_hash_of_code_differs_with_each_file_of_it_and_with_nothing_else(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "room").mkdir(parents=True)
    (package / "room" / "detector.py").write_text("LIMIT = 3")
    (package / "kernels.so").write_bytes(b"\x7fELF")
    before = code_hash(package)
    (package / "room" / "notes.txt").write_text("nothing")
    assert code_hash(package) == before
    found = {before}
    for change in ("LIMIT = 4", "LIMIT = 3 "):
        (package / "room" / "detector.py").write_text(change)
        found.add(code_hash(package))
    (package / "room" / "detector.py").write_text("LIMIT = 3")
    (package / "kernels.so").write_bytes(b"\x7fELG")
    found.add(code_hash(package))
    (package / "room" / "detector.py").rename(package / "detector.py")
    found.add(code_hash(package))
    assert len(found) == 5
    assert len(software()) <= 40  # of the ledger's column
