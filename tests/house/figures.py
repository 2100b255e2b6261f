"""Figures of the code's size and shape: `python -m tests.house.figures [--json FILE]`, beside those of figures.json.

Each function below is the definition of its figure. The package is `service/sunarc`, its compiled part
`service/kernels`; `client` is left out where said.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import dataclasses
import functools
import importlib
import io
import json
import re
import shlex
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np
import pandas as pd

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "service" / "sunarc"
KERNELS = ROOT / "service" / "kernels"
BEFORE = Path(__file__).with_name("figures.json")
"""The figures of the tree before its houses were parted."""
NATIVE = {".c", ".cc", ".cpp", ".h", ".hpp", ".pyx"}
HOUSES = ("imager", "archives", "hub", "lab", "client", "cli")
"""Rooms of the first level that stand on the library; all others are the library."""
RELATIVE_WHAT = re.compile(r"^(?:Whether|How)\b|\bwhat\b", re.IGNORECASE)
"""A first line of a docstring with a relative "what", or one that begins as a question."""
PHRASES = re.compile(
    r"\b(?:[Ii]s|[Aa]re) none\b|\bsa(?:ys|id|y) of\b|\bspeaks? for\b|\blooks? at\b|\blooked at\b|"
    r"(?<![-`])\bbeside\b(?!`| :)|"
    r"\bgiven up\b|\bnone (?:if|where|of which)\b"
)
"""Phrases of no textbook, in docstrings and in documents by hand; Python's `None` is a value, not a predicate."""
GENERATED = {
    "booted.md", "campaign.md", "checks.md", "codes.md", "metrics.md", "names.md", "results.md", "settings.md",
}  # fmt: skip
"""Pages that a command writes."""
SHORT_LINES = 80
LONG_SIGNATURE = 7
ROW = re.compile(r"assert .*(?:match|in|==) *r?f?[\"'][^\"']* [^\"']* [^\"']*[\"']|match=r?f?[\"'][^\"']* [^\"']* ")


class Module(NamedTuple):
    """One file of the package."""

    name: str
    text: str
    tree: ast.Module

    @property
    def room(self) -> str:
        """Return the top-level folder, or the file's own name."""
        return self.name.split(".")[1] if "." in self.name else self.name


def modules() -> dict[str, Module]:
    """Return every Python file of the package, by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text("utf-8")
        found[name] = Module(name, text, ast.parse(text))
    return found


def imports(module: Module, names: Mapping[str, Module]) -> set[str]:
    """Return the modules of the package that a module imports, also within functions: the innermost file of each."""
    found = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            candidates = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            candidates = [
                full if (full := f"{node.module}.{alias.name}") in names else node.module for alias in node.names
            ]
        else:
            continue
        found |= {name for name in candidates if name in names}
    return found - {module.name}


def importers(found: Mapping[str, Module]) -> dict[str, set[str]]:
    """Return which modules import each module."""
    users: dict[str, set[str]] = defaultdict(set)
    for module in found.values():
        for name in imports(module, found):
            users[name].add(module.name)
    return users


def code_lines(text: str) -> set[int]:
    """Return the lines that hold code: not blank, no comment, no docstring, no import."""
    tree = ast.parse(text)
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in _EMPTY_TOKENS
        for line in range(token.start[0], token.end[0] + 1)
    }
    return lines - _lines_of(tree, _is_string) - import_lines(tree)


_EMPTY_TOKENS = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip


def _is_string(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _is_import(node: ast.AST) -> bool:
    return isinstance(node, ast.Import | ast.ImportFrom)


def _lines_of(tree: ast.Module, wanted: object) -> set[int]:
    return {
        line
        for node in ast.walk(tree)
        if callable(wanted) and wanted(node)
        for line in range(node.lineno, node.end_lineno + 1)  # type: ignore[attr-defined]
    }


def import_lines(tree: ast.Module) -> set[int]:
    """Return the lines of import statements."""
    return _lines_of(tree, _is_import)


def native_code_lines() -> int:
    """Return the lines of compiled sources that are neither blank nor a comment of their own."""
    files = [path for path in KERNELS.rglob("*") if path.suffix in NATIVE]
    lines = [line.strip() for path in files for line in path.read_text("utf-8").splitlines()]
    return sum(bool(line) and not line.startswith(("//", "/*", "*")) for line in lines)


def comment_lines(text: str) -> int:
    """Return the lines with a comment, directives of tools apart."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type == tokenize.COMMENT and not re.match(r"# *(?:noqa|type:|fmt:|pragma)", token.string)
        for token in tokens
    )


def class_names(found: Mapping[str, Module]) -> Counter[str]:
    """Return how often each class name is defined in the package, the client apart."""
    return Counter(
        node.name
        for module in found.values()
        if module.room != "client"
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef)
    )


def classes_of_sightings(found: Mapping[str, Module]) -> list[str]:
    """Return the classes that have a pixel and a time or a direction as fields: each is a table or row of sightings."""
    pixel = {"x_px", "y_px", "x", "y", "pixels", "pixel", "pixel_px"}
    where = {"times", "time", "time_utc", "directions", "direction", "unix_s", "time_s"}
    found_here = []
    for module in found.values():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ClassDef) and module.room != "client":
                names = {
                    field.target.id
                    for field in node.body
                    if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
                }
                if names & pixel and names & where:
                    found_here.append(f"{module.name}.{node.name}")
    return found_here


def functions(found: Mapping[str, Module]) -> Iterator[tuple[Module, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield every function of the package with its module."""
    for module in found.values():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield module, node


def n_arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many arguments a function has, `self` and `cls` apart."""
    names = [argument.arg for argument in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)]
    return len([name for name in names if name not in {"self", "cls"}])


def faces(found: Mapping[str, Module], users: Mapping[str, set[str]]) -> dict[str, int]:
    """Return the number of names in `__all__` of each package that is imported from outside itself."""
    sizes = {}
    for name, module in found.items():
        outside = any(not user.startswith(name + ".") for user in users.get(name, ()))
        if _is_package(name) and outside:
            exported = [
                len(node.value.elts)
                for node in module.tree.body
                if isinstance(node, ast.Assign)
                and ast.unparse(node.targets[0]) == "__all__"
                and isinstance(node.value, ast.List | ast.Tuple)
            ]
            sizes[name] = sum(exported)
    return sizes


def private_names_in_tests() -> int:
    """Return the uses of names with a leading underscore that tests import from the package or read from an object.

    The documented methods of named tuples are public: their underscore keeps them apart from fields.
    """
    count = 0
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sunarc"):
                count += sum(re.match(r"_[^_]", alias.name) is not None for alias in node.names)
            elif isinstance(node, ast.Attribute) and re.match(r"_[^_]", node.attr):
                own = isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
                count += not own and node.attr not in {"_replace", "_asdict"}
    return count


def asserts_on_phrases() -> int:
    """Return the lines of tests that compare with, or match, an English phrase of three words or more."""
    return sum(
        ROW.search(line) is not None
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for line in path.read_text("utf-8").splitlines()
    )


def words_of_documents() -> dict[str, int]:
    """Return the words of README and docs: by hand, decisions, generated (codes, settings, metrics, results)."""
    counts = {"by hand": 0, "decisions": 0, "generated": 0}
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        kind = "decisions" if path.parent.name == "decisions" else "by hand"
        kind = "generated" if path.name in GENERATED else kind
        counts[kind] += len(path.read_text("utf-8").split())
    return counts


def docstrings(found: Mapping[str, Module]) -> Iterator[str]:
    """Yield the docstrings of modules, classes and functions, and those under a field or a constant."""
    for module in found.values():
        for node in ast.walk(module.tree):
            if _is_string(node):
                yield node.value.value  # type: ignore[attr-defined]


def prose(found: Mapping[str, Module]) -> dict[str, float]:
    """Return the share of first lines with a relative "what", and the phrases in docstrings and in pages by hand."""
    texts = list(docstrings(found))
    first = [text.strip().split("\n")[0] for text in texts]
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    by_hand = [path.read_text("utf-8") for path in pages if path.name not in GENERATED]
    return {
        "first lines with a relative what, %": _percent(
            sum(RELATIVE_WHAT.search(one) is not None for one in first), len(first)
        ),
        "phrases in docstrings": sum(len(PHRASES.findall(text)) for text in texts),
        "phrases in pages by hand": sum(len(PHRASES.findall(text)) for text in by_hand),
    }


def rooms_below(found: Mapping[str, Module]) -> dict[str, set[str]]:
    """Return the rooms of the first level that each of them imports."""
    below: dict[str, set[str]] = defaultdict(set)
    for module in found.values():
        below[module.room] |= {found[name].room for name in imports(module, found)} - {module.room, PACKAGE.name}
    return below


def floors(found: Mapping[str, Module]) -> int:
    """Return the rooms on the longest way down through imports."""
    below = rooms_below(found)

    @functools.cache
    def floor(room: str) -> int:
        return 1 + max(map(floor, below[room]), default=0)

    return max(map(floor, list(below)))


def code_by_house(rooms: Mapping[str, int]) -> dict[str, int]:
    """Return the code lines of the houses, of the library and of the compiled kernels."""
    houses = {house: rooms.get(house, 0) for house in HOUSES}
    return {"library": sum(rooms.values()) - sum(houses.values()), **houses, "kernels": native_code_lines()}


def cost_of(*command: str) -> tuple[float, float]:
    """Return processor time in s and the largest resident memory in MB of a command, the second of two runs."""
    script = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=True); "
        "u = resource.getrusage(resource.RUSAGE_CHILDREN); print(u.ru_utime + u.ru_stime, u.ru_maxrss / 1024)"
    )
    for _ in range(2):
        answer = subprocess.run([sys.executable, "-c", script, *command], capture_output=True, text=True, check=True)
    seconds, megabytes = map(float, answer.stdout.split())
    return round(seconds, 2), round(megabytes)


def loaded_by(statement: str) -> list[str]:
    """Return the modules that are loaded after a statement in a new process."""
    code = f"{statement}\nimport sys\nprint('\\n'.join(sorted(sys.modules)))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


class Station(NamedTuple):
    """A function that an array of sightings comes by: as an argument of a name, or as what it returns (no name).

    place: its file. own: whether the array is a column of `Sightings`, and no other of its length. fitting, solving:
    whether `calibrate_moved`, which the command calls, and the first round of the robust solve have begun.
    """

    place: str
    function: str
    name: str
    own: bool
    fitting: bool
    solving: bool


N_SIGHTINGS = 457
"""Rows of the fixed CSV file; nothing else in a fit has this length."""


def stations_of_sightings(*more: str) -> set[Station]:
    """Return where arrays of the length of the file's rows come by, in `sunarc calibrate` with more options.

    A function receives one as an argument, or within an argument that is a tuple, a list or a value with fields. The
    camera is an equidistant lens of 600 px/rad that looks up, at latitude 36.6, longitude -97.5, on 2024-06-21.
    """
    stations, begun, package = set[Station](), set[str](), str(PACKAGE)
    columns: dict[int, object] = {}

    def note(frame: FrameType, event: str, returned: object) -> None:
        code = frame.f_code
        if event not in {"call", "return"} or not code.co_filename.startswith(package) or code.co_name.startswith("<"):
            return
        place, function = str(Path(code.co_filename).relative_to(package)), code.co_qualname
        if place == "changes/record.py" and function == "calibrate_moved":
            begun.add(function)
        if event == "return" and function == "Sightings.__post_init__":
            columns.update({id(one): one for one in _arrays(frame.f_locals["self"])})
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        carried = {name: frame.f_locals.get(name) for name in names} if event == "call" else {"": returned}
        for name, value in carried.items():
            if found := _arrays(value):
                own = any(id(one) in columns for one in found)
                stations.add(Station(place, function, name, own, "calibrate_moved" in begun, "_run_rounds" in begun))
        if place == "calibration/fit/robust_fit.py":
            begun.add(function)

    with tempfile.TemporaryDirectory() as folder:
        path = _write_track(Path(folder) / "track.csv")
        options = shlex.split("--latitude 36.6 --longitude -97.5 --altitude 300 --image-size 1800,1800 --json")
        command = importlib.import_module("sunarc.cli.main").main
        arguments, sys.argv = sys.argv, ["sunarc", "calibrate", str(path), *options, *more]
        sys.setprofile(note)
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
                command()
        finally:
            sys.setprofile(None)
            sys.argv = arguments
    return stations


def _arrays(value: object, depth: int = 2) -> list[np.ndarray]:
    """Return the memory of the arrays with as many rows as the file that a value holds."""
    if isinstance(value, np.ndarray):
        of_length = N_SIGHTINGS in value.shape
        while isinstance(value.base, np.ndarray):
            value = value.base
        return [value] if of_length else []
    items: Iterable[object] = ()
    if depth and isinstance(value, tuple | list):
        items = value[:50]
    elif depth and dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = (getattr(value, field.name, None) for field in dataclasses.fields(value))
    return [one for item in items for one in _arrays(item, depth - 1)]


def way_figures() -> dict[str, int]:
    """Return how many functions, files, rooms, returns and names: in the whole command, and until the solve.

    Where the projection is named the command is `calibrate` at once; else five are compared first.
    """
    stations, named = stations_of_sightings(), stations_of_sightings("--projection", "equidistant")
    ways = {
        "into the fit": stations,
        "until the solve": {one for one in stations if not one.solving},
        "until the solve, columns alone": {one for one in stations if one.own and not one.solving},
        "of `calibrate` to the solve": {one for one in named if one.own and one.fitting and not one.solving},
    }
    found: dict[str, int] = {}
    for title, way in ways.items():
        received, returned = [one for one in way if one.name], [one for one in way if not one.name]
        parts = {
            "functions": len({(one.place, one.function) for one in received}),
            "files": len({one.place for one in received}),
            "rooms": len({Path(one.place).parent for one in received}),
            "returns": len({(one.place, one.function) for one in returned}),
            "names": len({one.name for one in received}),
        }
        found |= {f"sightings' way {title}: {name}": count for name, count in parts.items()}
    return found


def _write_track(path: Path) -> Path:
    sky = importlib.import_module("pvlib.solarposition")
    times = pd.date_range("2024-06-21T12:30", periods=N_SIGHTINGS, freq="93s", tz="UTC")
    sun = sky.spa_python(times, 36.6, -97.5, 300)
    zenith, azimuth = np.radians(sun["apparent_zenith"]), np.radians(sun["azimuth"])
    x, y = 900 - 600 * zenith * np.sin(azimuth), 900 - 600 * zenith * np.cos(azimuth)
    noise = np.random.default_rng(1).normal(0, 0.3, (2, N_SIGHTINGS))
    rows = [
        f"{t:%Y-%m-%dT%H:%M:%SZ},{a:.4f},{b:.4f}" for t, a, b in zip(times, x + noise[0], y + noise[1], strict=True)
    ]
    path.write_text("\n".join(["time_utc,x_px,y_px", *rows]) + "\n", "utf-8")
    return path


PIXEL = "sunarc.formats.calibration_document, sunarc.optics.backward"
"""What answers which direction a pixel of a document has."""


def figures() -> dict[str, object]:
    """Return all figures by name."""
    found = modules()
    users = importers(found)
    code = {name: code_lines(module.text) for name, module in found.items()}
    n_code = sum(map(len, code.values())) + native_code_lines()
    lines = {name: module.text.count("\n") for name, module in found.items()}
    rooms: Counter[str] = Counter()
    for name, module in found.items():
        rooms[module.room] += len(code[name])
    single = [n for n in found if len(users[n]) == 1]
    face_sizes = faces(found, users)
    version, pixel = cost_of(sys.executable, "-m", "sunarc", "--version"), loaded_by(f"import {PIXEL}")
    return {
        "modules": len(found),
        "rooms at the first level: folders": sum(_is_package(f"{PACKAGE.name}.{room}") for room in rooms),
        "rooms at the first level: files": sum(not _is_package(f"{PACKAGE.name}.{room}") for room in rooms) - 1,
        "floors": floors(found),
        "lines a module": round(sum(lines.values()) / len(found)),
        "modules that one other imports": len(single),
        "of them below 150 lines, no __init__": len([n for n in single if lines[n] < 150 and not _is_package(n)]),
        "modules below 80 lines": sum(count < SHORT_LINES for count in lines.values()),
        "import lines over code, %": _percent(sum(len(import_lines(m.tree)) for m in found.values()), n_code),
        "code lines": n_code,
        "comment lines over code, %": _percent(sum(comment_lines(m.text) for m in found.values()), n_code),
        "classes that hold sightings": len(classes_of_sightings(found)),
        "class names defined twice": sum(count > 1 for count in class_names(found).values()),
        "functions with 7 arguments or more, cli apart": sum(
            n_arguments(function) >= LONG_SIGNATURE for module, function in functions(found) if module.room != "cli"
        ),
        "functions with 7 arguments or more": sum(n_arguments(f) >= LONG_SIGNATURE for _, f in functions(found)),
        "faces": len(face_sizes),
        "faces with more than 20 names": sum(size > 20 for size in face_sizes.values()),
        "sunarc --version, processor s": version[0],
        "sunarc --version, memory MB": version[1],
        "modules of ours loaded by what answers a pixel": sum(name.startswith("sunarc") for name in pixel),
        "heavy modules among them": sorted({"numba", "scipy", "cv2", "pandas"} & set(pixel)),
        **way_figures(),
        "private names in tests": private_names_in_tests(),
        "asserts on a phrase": asserts_on_phrases(),
        "words of documents": words_of_documents(),
        **prose(found),
        "code lines by house": code_by_house(rooms),
        "code lines by room": dict(sorted(rooms.items())),
    }


def _is_package(name: str) -> bool:
    return (PACKAGE.parent / Path(*name.split("."))).is_dir()


def _percent(part: int, whole: int) -> float:
    return round(100 * part / whole, 1)


def main() -> None:
    """Print the figures beside those of figures.json, or write them to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    target = parser.parse_args().json
    now = figures()
    if target:
        target.write_text(json.dumps(now, indent=1) + "\n", "utf-8")
    before = json.loads(BEFORE.read_text("utf-8")) if BEFORE.exists() else {}
    for name, value in now.items():
        if isinstance(value, dict):
            earlier = before.get(name, {})
            for part in {**earlier, **value}:
                _show(f"{name}: {part}", earlier.get(part, 0), value.get(part, 0))
        else:
            _show(name, before.get(name, ""), value)


def _show(name: str, before: object, now: object) -> None:
    sys.stdout.write(f"{name:58s} {before!s:>12} {now!s:>12}\n")


if __name__ == "__main__":
    main()
