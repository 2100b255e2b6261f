"""Draws the rooms of the package and the imports between them as SVG, from the sources and the import contract.

    python docs/architecture/draw_rooms.py        # writes docs/architecture/rooms.svg

A row is a layer of the contract "rooms import downward only" in pyproject.toml. An arrow is an import; imports that a
path through other rooms implies are left out. A test compares the stored picture with a new one.
"""

from __future__ import annotations

import ast
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURE = Path(__file__).with_name("rooms.svg")
CONTRACT = "rooms import downward only"

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


def layers(pyproject: str) -> list[list[str]]:
    """Return the rooms of each layer of the contract, the highest first."""
    contracts = tomllib.loads(pyproject)["tool"]["importlinter"]["contracts"]
    (rows,) = (contract["layers"] for contract in contracts if contract["name"] == CONTRACT)
    return [[room.strip() for room in row.split("|")] for row in rows if row != "__main__"]


def imports_between_rooms(package: Path) -> Imports:
    """Return for each room of the package the rooms whose modules it imports."""
    found: Imports = {}
    for path in sorted(package.rglob("*.py")):
        room = _room(path.relative_to(package).as_posix())
        targets = found.setdefault(room, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            targets |= {target for target in _imported_rooms(node) if target != room}
    return {room: {target for target in targets if target in found} for room, targets in found.items()}


def without_implied(imports: Imports) -> Imports:
    """Return the imports but for those that a path through other rooms implies."""
    reached: Imports = {}

    def reach(room: str) -> set[str]:
        if room not in reached:
            reached[room] = set(imports[room]).union(*(reach(target) for target in imports[room]))
        return reached[room]

    return {
        room: {target for target in targets if not any(target in reach(other) for other in targets - {target})}
        for room, targets in imports.items()
    }


def picture(rows: list[list[str]], imports: Imports, package: Path) -> str:
    """Return the SVG."""
    boxes = {
        room: (_MARGIN + (number + 0.5) * (_WIDTH - 2 * _MARGIN) / len(row), _MARGIN + level * _ROW_HEIGHT)
        for level, row in enumerate(rows)
        for number, room in enumerate(row)
    }
    height = 2 * _MARGIN + (len(rows) - 1) * _ROW_HEIGHT + _BOX_HEIGHT
    arrows = [_arrow(boxes[a], boxes[b]) for a, b in sorted(_edges(imports)) if a in boxes and b in boxes]
    shapes = [_box(room, *boxes[room], _width(rows, room), _subrooms(package / room)) for row in rows for room in row]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" font-family="sans-serif">',
            "<title>Rooms of sunarc and their imports</title>",
            _ARROW_HEAD,
            f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
            *arrows,
            *shapes,
            "</svg>\n",
        ]
    )


def _room(name: str) -> str:
    return name.partition("/")[0].removesuffix(".py")


def _imported_rooms(node: ast.AST) -> set[str]:
    if isinstance(node, ast.ImportFrom) and node.module == "sunarc":
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        names = [node.module or ""]
    elif isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        return set()
    return {name.split(".")[1] for name in names if name.startswith("sunarc.")}


def _edges(imports: Imports) -> set[tuple[str, str]]:
    return {(room, target) for room, targets in without_implied(imports).items() for target in targets}


def _subrooms(folder: Path) -> str:
    if not folder.is_dir():
        return ""
    return "  ".join(sorted(path.name for path in folder.iterdir() if (path / "__init__.py").exists()))


def _width(rows: list[list[str]], room: str) -> float:
    row = next(row for row in rows if room in row)
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
    lines = [
        f'<rect {frame} rx="5" fill="#eef3f7" stroke="#5b7083"/>',
        f'<text x="{x:.0f}" y="{baseline:.0f}" font-size="14" text-anchor="middle">{escape(room)}</text>',
    ]
    if subrooms:
        size = min(11.0, 11.0 * (width - 10) / (len(subrooms) * _LETTER))
        lines.append(
            f'<text x="{x:.0f}" y="{y + 39:.0f}" font-size="{size:.1f}" text-anchor="middle" fill="#44586a">'
            f"{escape(subrooms)}</text>"
        )
    return "\n".join(lines)


def draw(root: Path = ROOT) -> str:
    """Return the picture of the sources as they are."""
    package = root / "service" / "sunarc"
    rows = layers((root / "pyproject.toml").read_text(encoding="utf-8"))
    return picture(rows, imports_between_rooms(package), package)


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8")
