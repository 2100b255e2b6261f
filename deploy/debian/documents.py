"""Lays the documents of a checkout into the package's folder of documents.

    documents.py CHECKOUT FOLDER

docs/ becomes the folder itself, deploy/ is laid into it. A link to what the package is without becomes its text.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

LINK = re.compile(r"!?\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")
LEFT_OUT = {".ipynb", ".png", ".svg"}
"""Notebooks, whose packages a field computer has not, and pictures: half of the documents' bytes."""
DEPLOYED = ("hub/*", "sunarc.toml", "usb3.conf", "prometheus-rules.yml", "grafana-board.json")


def lay_documents(checkout: Path, folder: Path) -> None:
    """Copy what deploy/ has for the reader, all pages, and the files of docs/ that they link to."""
    docs, deploy = checkout / "docs", checkout / "deploy"
    laid = {file: folder / file.relative_to(deploy) for pattern in DEPLOYED for file in deploy.glob(pattern)}
    pages = sorted(docs.rglob("*.md"))
    wanted = {*pages, *(target for page in pages for target in targets(page) if target.is_relative_to(docs))}
    wanted |= {file for target in wanted if target.is_dir() for file in target.iterdir()}
    kept = {file for file in wanted if file.suffix not in LEFT_OUT}
    laid |= {file: folder / file.relative_to(docs) for file in kept if file.is_file()}
    for file, place in laid.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, place)
    folders = {place.parent for place in laid.values()}
    laid |= {file: folder / file.relative_to(docs) for file in wanted if folder / file.relative_to(docs) in folders}
    for page in pages:
        laid[page].write_text(with_links(page, laid), encoding="utf-8")


def targets(page: Path) -> list[Path]:
    """Return the files and folders that a page links to."""
    found = LINK.findall(page.read_text(encoding="utf-8"))
    return [Path(os.path.normpath(page.parent / target)) for _, target, _ in found if "://" not in target]


def with_links(page: Path, laid: dict[Path, Path]) -> str:
    """Return a page's text, its links leading to where the files were laid."""

    def linked(match: re.Match[str]) -> str:
        text, target, part = match.groups(default="")
        if "://" in target:
            return match[0]
        place = laid.get(Path(os.path.normpath(page.parent / target)))
        return text if place is None else f"[{text}]({os.path.relpath(place, laid[page].parent)}{part})"

    return LINK.sub(linked, page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    lay_documents(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())
