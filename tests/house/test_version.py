"""No two packages have one name: between releases it has the number of commits; for dpkg the release is newer."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path

import pytest


def package_version(root: Path, tree: Path) -> str:
    command: list[str | Path] = [root / "deploy" / "build-deb", "--version", "--tree", tree]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize(
    ("stated", "commits", "expected"),
    [("0.3.0", 2, "0.3.0"), ("0.4.0.dev0", 2, "0.4.0~dev2"), ("0.4.0.dev0", 3, "0.4.0~dev3")],
)
def test_packages_between_releases_are_numbered(
    root: Path, tmp_path: Path, stated: str, commits: int, expected: str
) -> None:
    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    (tmp_path / "pyproject.toml").write_text(f'[project]\nname = "sunarc"\nversion = "{stated}"\n')
    git("add", ".")
    for number in range(commits):
        git("commit", "--allow-empty", "-m", str(number))
    assert package_version(root, tmp_path) == expected


def test_a_package_is_older_than_the_release_that_it_comes_before(root: Path) -> None:
    with (root / "pyproject.toml").open("rb") as file:
        stated = tomllib.load(file)["project"]["version"]
    found, release = package_version(root, root), stated.partition(".dev")[0]
    relation = "eq" if found == release else "lt"
    subprocess.run(["dpkg", "--compare-versions", found, relation, release], check=True)
    subprocess.run(["dpkg", "--compare-versions", found, "gt", "0.2.0"], check=True)
