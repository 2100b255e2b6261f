"""Feed damaged files to every reader of files: each answers or refuses in one line, within a second.

    .venv/bin/python -m tests.files.fuzz --count 1000000 --seed 1

draws so many cases in all (hypothesis), from the sound files of every reader: bytes changed, cut, doubled, and replaced
by what numbers, names and nests can be. A case fails that raises anything but the project's own errors, or takes longer
than a second. Failures are printed with the shortest such file, which is kept in `--keep`; the memory that was
taken in all is printed. `--only NAME` asks one reader.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from tests.fixtures.calibration import distinctive_calibration

from sunarc.api.arrays import read_rows
from sunarc.archive.csv_files import read_pairs, read_sightings
from sunarc.archive.fleet.feed_rows import FeedRow, feed_lines, read_feed_lines
from sunarc.calibration.lens_library.lens_type import lens_type_from_json
from sunarc.calibration.model.document import from_document, to_document
from sunarc.errors import InputError, SunarcError
from sunarc.exports.formats import FORMATS, read_view
from sunarc.offline.calibrate_files import read_joint_spec
from sunarc.reanalysis.files import read_image, read_lines
from sunarc.settings.load import load_hub_settings, load_settings
from sunarc.studies.benchmark_cases import BenchmarkTruth
from sunarc.studies.benchmark_files import read_case, read_entry
from sunarc.studies.benchmark_scores import score

ROOT = Path(__file__).resolve().parents[2]
SLOWEST_S = 1.0
_MOST_EDITS = 6
TOKENS = (
    b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"nan", b"NaN", b"-inf", b"Infinity", b"1e999", b"-1", b"0", b"-0.0",
    b"1e-320", b"9" * 400, b"1" * 5000, b"2013-02-30T25:61:61Z", b"9999-12-31T23:59:59.9999999Z",
    b"0001-01-01T00:00:00Z",
    b"null", b"true", b'""', b"[]", b"{}", b"[" * 3000, b'{"a":' * 3000, b",", b"\n", b"\r", b'"', b"'", b"\\", b"#",
    b"!!python/object/apply:os.system", b"&a [*a]", b"%YAML 9.9", b"\xf0\x9f\x8c\x9e", b"\xc3\x28", b"../../etc/passwd",
)  # fmt: skip
"""What is set into a file."""


@dataclass(frozen=True)
class Reader:
    """A reader of files: `read` takes a file's bytes and a folder of its own; `sound` are files that it reads."""

    name: str
    sound: tuple[bytes, ...]
    read: Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Failure:
    """A file that a reader did not bear."""

    reader: str
    content: bytes
    why: str


def edited(sound: bytes, edits: list[tuple[str, int, int, bytes]]) -> bytes:
    """Return a file changed at some places; places are taken modulo its length."""
    content = bytearray(sound)
    for kind, place, length, token in edits:
        begin = place % (len(content) + 1)
        end = min(begin + length, len(content))
        if kind == "set":
            content[begin:end] = token
        elif kind == "cut":
            del content[begin:end]
        elif kind == "end":
            del content[begin:]
        elif kind == "double":
            content[begin:begin] = content[begin:end] * 3
        elif begin < len(content):
            content[begin] ^= 1 << (length % 8)
    return bytes(content)


EDITS = st.lists(
    st.tuples(
        st.sampled_from(("set", "set", "flip", "cut", "double", "end")),
        st.integers(0, 2**20),
        st.integers(0, 40),
        st.one_of(st.sampled_from(TOKENS), st.binary(max_size=8)),
    ),
    min_size=1,
    max_size=_MOST_EDITS,
)


def at_path(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """Return a reader of a path as one of bytes."""

    def of_bytes(content: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(content)
        return read(path)

    return of_bytes


def of_json(read: Callable[[object], object]) -> Callable[[bytes, Path], object]:
    """Return a reader of a JSON value as one of bytes; what is no JSON does not come to it."""

    def of_bytes(content: bytes, _: Path) -> object:
        try:
            value = json.loads(content)
        except (ValueError, RecursionError):
            return None
        return read(value)

    return of_bytes


def entry_of(content: bytes, folder: Path) -> object:
    """Read and score an entry of the benchmark."""
    (folder / "s000.csv").write_bytes(content)
    pixels, directions = np.array([[k, 5.0] for k in range(9)]), np.tile([0.0, 0.6, 0.8], (9, 1))
    said = {"lens": "a", "condition": "b", "answerable": True, "track_deg": np.zeros(9), "fallback_deg": np.ones(9)}
    truth = BenchmarkTruth(pixels=pixels, directions=directions, px_per_deg=np.tile(np.eye(2), (9, 1, 1)), **said)  # type: ignore[arg-type] # columns by name
    truths = {"s000": truth}
    return score("entrant", truths, read_entry(folder, truths))


def case_of(content: bytes, folder: Path) -> object:
    """Read a case of the benchmark with its sightings damaged."""
    (folder / "case.json").write_text(
        '{"case": "s000", "latitude": 1, "longitude": 2, "altitude": 3, "width": 9, "height": 9, "projection": null}'
    )
    (folder / "queries.csv").write_text("x_px,y_px\n1,2\n")
    (folder / "sightings.csv").write_bytes(content)
    return read_case(folder)


def readers() -> list[Reader]:
    """Return all readers with their sound files."""
    solved, day = distinctive_calibration(), datetime(2013, 5, 13, tzinfo=UTC)
    document = to_document(
        solved, id="one", camera="roof", state="current", created_at=day, valid_from=day, valid_until=None,
        pose_epoch="1", software_version="0.4.0",
    )  # fmt: skip
    rows = b"".join(b"2013-05-13T%02d:00:00Z,%d.5,71,0.3,sun,,\n" % (hour, 10 * hour) for hour in range(11, 20))
    sightings = b"time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg\n" + rows
    seen = b"time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg,apparent_zenith_deg,apparent_azimuth_deg\n"
    image = (np.arange(400).reshape(20, 20) % 251).astype(np.uint8)
    npy = io.BytesIO()
    np.save(npy, np.arange(12.0).reshape(6, 2))
    entry = b"x_px,y_px,zenith_deg,azimuth_deg,sigma_deg\n" + b"".join(b"%d,5,45,90,0.1\n" % k for k in range(9))
    found = [
        Reader("sightings", (sightings,), at_path("a.csv", lambda p: read_sightings(read_lines(p), name=p.name))),
        Reader(
            "pairs",
            (b"x_px,y_px\n1,2\n3.5,4\n",),
            at_path("a.csv", lambda p: read_pairs(read_lines(p), columns=("x_px", "y_px"), name=p.name)),
        ),
        Reader("settings", ((ROOT / "deploy" / "sunarc.toml").read_bytes(),), at_path("a.toml", load_settings)),
        Reader("hub", ((ROOT / "deploy" / "hub" / "hub.toml").read_bytes(),), at_path("a.toml", load_hub_settings)),
        Reader("npy", (npy.getvalue(),), lambda content, _: read_rows(content, columns=(2, 3), most=1000)),
        Reader("document", (json.dumps(document).encode(),), of_json(from_document)),
        Reader(
            "feed",
            (feed_lines([FeedRow(seq=1, kind="day", data={"a": 1.5}), FeedRow(seq=2, kind="status", data=None)]),),
            feed_of,
        ),
        Reader("entry", (entry,), entry_of),
        Reader("case", (seen + rows.replace(b",,\n", b",,,45,90\n"),), case_of),
        Reader("joint", (b'latitude = 1.0\nlongitude = 2.0\n[[entry]]\ncamera = "a"\nfile = "a.csv"\n',), joint_of),
        Reader("lens", (b'{"units": [], "lens": {"projection": "equisolid"}}',), of_json(lens_type_from_json)),
    ]
    for form in FORMATS.values():
        if form.read is not None:
            try:
                made = form.write(solved, document)
            except (InputError, ModuleNotFoundError):
                continue
            found.append(Reader(f"view-{form.name}", (made.content,), view_of))
    for ending in (".png", ".jpg", ".tiff", ".bmp"):
        content = cv2.imencode(ending, image)[1].tobytes()
        found.append(Reader(f"image{ending}", (content,), at_path("a" + ending, read_image)))
    return found


def feed_of(content: bytes, _: Path) -> object:
    return read_feed_lines(content, after=0)


def view_of(content: bytes, _: Path) -> object:
    return read_view(content, name="a", beside=lambda _: None)


def joint_of(content: bytes, folder: Path) -> object:
    (folder / "joint.toml").write_bytes(content)
    return read_joint_spec(folder / "joint.toml")


def fuzzed(reader: Reader, *, count: int, number: int) -> Failure | None:
    """Ask a reader so many damaged files; return the shortest that it does not bear, or None."""
    worst: list[Failure] = []

    with tempfile.TemporaryDirectory() as name:

        @seed(number)
        @settings(
            max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck),
            phases=(Phase.generate, Phase.shrink),
        )  # fmt: skip
        @given(st.sampled_from(reader.sound), EDITS)
        def bears(sound: bytes, edits: list[tuple[str, int, int, bytes]]) -> None:
            content = edited(sound, edits)
            why = trouble(reader, content, Path(name))
            if why is not None:
                worst.append(Failure(reader.name, content, why))
                raise AssertionError(why)

        try:
            bears()
        except AssertionError:
            return worst[-1]
        except BaseExceptionGroup:
            return min(worst, key=lambda one: len(one.content))
    return None


def trouble(reader: Reader, content: bytes, folder: Path) -> str | None:
    """Return what is wrong with how a reader takes a file; None where it answers or refuses it in time."""
    begin = time.process_time()
    try:
        reader.read(content, folder)
    except SunarcError as error:
        if "\n" in str(error).strip() and reader.name not in {"settings", "hub"}:
            return f"a refusal of several lines: {str(error)[:200]!r}"
    except Exception as error:  # noqa: BLE001 - whatever comes is what is sought
        return f"{type(error).__name__}: {str(error)[:200]}"
    took = time.process_time() - begin
    return f"took {took:.1f} s" if took > SLOWEST_S else None


def main() -> int:
    """Ask all readers; exit 1 where one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="cases in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--keep", type=Path, help="folder for the files that fail")
    chosen = parser.parse_args()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    asked = [one for one in readers() if not chosen.only or one.name in chosen.only]
    each, before, failures = -(-chosen.count // max(len(asked), 1)), peak_mb(), 0
    for reader in asked:
        found = fuzzed(reader, count=each, number=chosen.seed)
        print(f"{reader.name}: {each} cases: {'as they should' if found is None else found.why}", flush=True)
        failures += found is not None
        if found is not None and chosen.keep is not None:
            chosen.keep.mkdir(parents=True, exist_ok=True)
            (chosen.keep / reader.name).write_bytes(found.content)
    print(f"{each * len(asked)} cases of seed {chosen.seed}, {failures} readers fail, {peak_mb() - before:.0f} MB more")
    return int(failures > 0)


def peak_mb() -> float:
    """Return the largest memory so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    sys.exit(main())
