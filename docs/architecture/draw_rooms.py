"""Draws the houses of the package, and the rooms of each, with the imports between them, as SVG from the sources.

    python docs/architecture/draw_rooms.py        # writes docs/architecture/*.svg

A row holds the rooms that import one another in no way; every import points downward. Imports that a path through
other rooms implies are left out. A test compares the stored pictures with new ones.
"""

from __future__ import annotations

import ast
from functools import cache
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(__file__).parent
HOUSES = ("imager", "archives", "hub", "lab", "client", "cli")
"""Rooms of the first level that stand on the library; all others are the library."""

_WIDTH = 1080
_ROW_HEIGHT = 86
_BOX_HEIGHT = 50
_MARGIN = 20
_LETTER = 6.6
"""Width of a letter of the small font, px."""

_ARROW_HEAD = (
    '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="#5b7083"/></marker></defs>'
)

Imports = dict[str, set[str]]


def imports_between_rooms(package: Path, name: str = "sunarc") -> Imports:
    """Return for each folder and file of a package the others whose modules it imports.

    Parameters
    ----------
    package : the folder.
    name : of the package, as it is imported.
    """
    found: Imports = {}
    for path in sorted(package.rglob("*.py")):
        room = _room(path.relative_to(package).as_posix())
        targets = found.setdefault(room, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            targets |= {target for target in _imported_rooms(node, name) if target != room}
    return {room: {target for target in targets if target in found} for room, targets in found.items()}


def without_implied(imports: Imports) -> Imports:
    """Return the imports but for those that a path through other rooms implies."""

    @cache
    def reach(room: str) -> frozenset[str]:
        return frozenset(imports[room]).union(*(reach(target) for target in imports[room]))

    return {
        room: {target for target in targets if not any(target in reach(other) for other in targets - {target})}
        for room, targets in imports.items()
    }


def rows_of(imports: Imports) -> list[list[str]]:
    """Return the rooms by floor, the highest first: a room stands above all that it imports."""

    @cache
    def floor(room: str) -> int:
        return 1 + max(map(floor, imports[room]), default=0)

    highest = max(map(floor, imports))
    return [sorted(room for room in imports if floor(room) == level) for level in range(highest, 0, -1)]


def picture(title: str, imports: Imports, package: Path) -> str:
    """Return the SVG of rooms and their imports."""
    rows = rows_of(imports)
    boxes = {
        room: (_MARGIN + (number + 0.5) * (_WIDTH - 2 * _MARGIN) / len(row), _MARGIN + level * _ROW_HEIGHT)
        for level, row in enumerate(rows)
        for number, room in enumerate(row)
    }
    height = 2 * _MARGIN + (len(rows) - 1) * _ROW_HEIGHT + _BOX_HEIGHT
    arrows = [
        _arrow(boxes[room], boxes[target])
        for room, targets in sorted(without_implied(imports).items())
        for target in sorted(targets)
    ]
    shapes = [_box(room, *boxes[room], _width(row), _subrooms(package / room)) for row in rows for room in row]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" font-family="sans-serif">',
            f"<title>{escape(title)}</title>",
            _ARROW_HEAD,
            f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
            *arrows,
            *shapes,
            "</svg>\n",
        ]
    )


def pictures(root: Path = ROOT) -> dict[str, str]:
    """Return the pictures of the sources by file name: the houses, the library's rooms, those of each house."""
    package = root / "service" / "sunarc"
    rooms = imports_between_rooms(package)
    library = _among(rooms, set(rooms) - {*HOUSES, "__init__", "__main__"})
    houses = _among(rooms, set(HOUSES))
    for house, targets in houses.items():
        if rooms[house] & set(library):
            targets.add("library")
    houses["library"] = set()
    found = {
        "houses.svg": picture("Houses of sunarc and their imports", houses, package),
        "library.svg": picture("Rooms of the library and their imports", library, package),
    }
    for house in HOUSES:
        inside = imports_between_rooms(package / house, f"sunarc.{house}")
        inside = _among(inside, set(inside) - {"__init__"})
        found[f"{house}.svg"] = picture(f"Rooms of {house} and their imports", inside, package / house)
    return found


def _among(imports: Imports, rooms: set[str]) -> Imports:
    """Return the imports of some rooms from one another."""
    return {room: imports[room] & rooms for room in sorted(rooms)}


def _room(name: str) -> str:
    return name.partition("/")[0].removesuffix(".py")


def _imported_rooms(node: ast.AST, package: str) -> set[str]:
    if isinstance(node, ast.ImportFrom) and node.module == package:
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        names = [node.module or ""]
    elif isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        return set()
    return {name.removeprefix(f"{package}.").split(".")[0] for name in names if name.startswith(f"{package}.")}


def _subrooms(folder: Path) -> str:
    if not folder.is_dir():
        return ""
    return "  ".join(sorted(path.name for path in folder.iterdir() if (path / "__init__.py").exists()))


def _width(row: list[str]) -> float:
    return min((_WIDTH - 2 * _MARGIN) / len(row) - 16, 700.0)


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    x1, y1, x2, y2 = start[0], start[1] + _BOX_HEIGHT, end[0], end[1]
    bend = 0.5 * (y2 - y1)
    return (
        f'<path d="M{x1:.0f} {y1:.0f}C{x1:.0f} {y1 + bend:.0f} {x2:.0f} {y2 - bend:.0f} {x2:.0f} {y2:.0f}" '
        'fill="none" stroke="#9fb0bf" stroke-width="1.2" marker-end="url(#head)"/>'
    )


def _box(room: str, x: float, y: float, width: float, subrooms: str) -> str:
    frame = f'x="{x - width / 2:.0f}" y="{y:.0f}" width="{width:.0f}" height="{_BOX_HEIGHT}"'
    baseline = y + (20 if subrooms else 30)
    size = min(14.0, 14.0 * (width - 6) / (len(room) * 8.0))
    lines = [
        f'<rect {frame} rx="5" fill="#eef3f7" stroke="#5b7083"/>',
        f'<text x="{x:.0f}" y="{baseline:.0f}" font-size="{size:.1f}" text-anchor="middle">{escape(room)}</text>',
    ]
    if subrooms:
        size = min(11.0, 11.0 * (width - 10) / (len(subrooms) * _LETTER))
        lines.append(
            f'<text x="{x:.0f}" y="{y + 39:.0f}" font-size="{size:.1f}" text-anchor="middle" fill="#44586a">'
            f"{escape(subrooms)}</text>"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    for name, content in pictures().items():
        (FOLDER / name).write_text(content, encoding="utf-8")
