"""The parts of deploy/release: what it cuts, compares, lists and refuses."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

CHANGELOG = "# Changelog\n\n## [Unreleased]\n\n### Added\n\n- A thing.\n\n## [0.3.0] - 2026-11-01\n\n- Old.\n"


@pytest.fixture(scope="module")
def release(root: Path) -> ModuleType:
    found = importlib.util.spec_from_file_location("release", root / "deploy" / "release.py")
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def installed(site: Path, name: str, *, licence: str = "", text: str = "", version: str = "1.0") -> None:
    """Lay a distribution into a folder."""
    folder = site / f"{name}-{version}.dist-info"
    folder.mkdir(parents=True)
    stated = f"License-Expression: {licence}\n" if licence else ""
    (folder / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\n{stated}")
    if text:
        (folder / "licenses").mkdir()
        (folder / "licenses" / "LICENSE.txt").write_text(text)


def test_a_changelog_is_cut_once(release: ModuleType) -> None:
    cut = release.cut(CHANGELOG, "0.4.0", "2026-11-25")
    assert "## [Unreleased]\n\n## [0.4.0] - 2026-11-25\n\n### Added\n" in cut
    assert cut.count("- A thing.") == cut.count("- Old.") == 1
    for again in ("0.4.0", "0.5.0"):  # it stands there; nothing is unreleased
        with pytest.raises(release.ReleaseError):
            release.cut(cut, again, "2026-11-26")


def test_the_changelog_and_the_version_of_the_tree_can_be_cut(root: Path, release: ModuleType) -> None:
    project, changelog = ((root / name).read_text("utf-8") for name in ("pyproject.toml", "CHANGELOG.md"))
    stated = release.STATED.search(project)[1]
    version = stated.removesuffix(".dev0")
    if version == stated:  # the tree is a release
        assert f"## [{version}] - " in changelog
        return
    changelog = changelog.replace(release.UNRELEASED, f"{release.UNRELEASED}\n\n- A change.", 1)  # after one, none is
    assert f"## [{version}] - " in release.cut(changelog, version, "2026-11-25")
    assert f'version = "{version}"' in release.with_version(project, version)


@pytest.fixture
def tree(tmp_path: Path, release: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository to release from; its files are not built."""
    (tmp_path / "docs").mkdir()
    for name, text in {
        "pyproject.toml": '[project]\nversion = "0.4.0.dev0"\n',
        "CHANGELOG.md": CHANGELOG,
        "docs/openapi.json": '{"version": "0.4.0.dev0"}\n',
    }.items():
        (tmp_path / name).write_text(text)
    for arguments in (["init", "-q"], ["config", "user.name", "a"], ["config", "user.email", "a@b"], ["add", "."]):
        subprocess.run(["git", *arguments], cwd=tmp_path, check=True)
    subprocess.run(["git", "commit", "-qm", "all"], cwd=tmp_path, check=True)
    monkeypatch.setattr(release, "ROOT", tmp_path)
    monkeypatch.setattr(release, "files_of", lambda _: None)
    return tmp_path


def git(tree: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=tree, check=True, capture_output=True, text=True).stdout.strip()


def test_a_release_is_one_commit_of_its_version_everywhere(tree: Path, release: ModuleType) -> None:
    assert release.main(["0.4.0", "--date", "2026-11-26"]) == 0
    changed = set(git(tree, "show", "--format=", "--name-only").split())
    assert changed == {"pyproject.toml", "CHANGELOG.md", "docs/openapi.json"}
    assert "0.4.0.dev0" not in "".join((tree / name).read_text() for name in changed)
    assert "## [0.4.0] - 2026-11-26" in (tree / "CHANGELOG.md").read_text()
    assert release.main(["0.4.0"]) == 1  # once
    assert git(tree, "rev-list", "--count", "HEAD") == "2"


@pytest.mark.parametrize("fault", ["dirty", "no commit", "0.5.0", "0.4"])
def test_what_cannot_be_released_leaves_the_tree_as_it_was(tree: Path, release: ModuleType, fault: str) -> None:
    if fault == "dirty":
        (tree / "pyproject.toml").write_text('[project]\nversion = "0.4.0.dev0"\nname = "a"\n')
    if fault == "no commit":
        (tree / ".git" / "hooks" / "pre-commit").write_text("#!/bin/sh\nexit 1\n")
        (tree / ".git" / "hooks" / "pre-commit").chmod(0o755)
    before = git(tree, "diff", "HEAD")
    assert release.main([fault if fault[0] == "0" else "0.4.0"]) == 1
    assert git(tree, "diff", "HEAD") == before
    assert git(tree, "rev-list", "--count", "HEAD") == "1"


@pytest.mark.parametrize("version", ["0.4.1", "0.3.0", "0.4", "0.4.0.dev0", "v0.4.0", ""])
def test_a_version_that_is_not_the_one_under_way_is_refused(release: ModuleType, version: str) -> None:
    with pytest.raises(release.ReleaseError):
        release.with_version('version = "0.4.0.dev0"\n', version)


def test_two_builds_that_differ_are_refused(tmp_path: Path, release: ModuleType) -> None:
    first, second = tmp_path / "a", tmp_path / "b"
    first.write_bytes(b"same")
    second.write_bytes(b"same")
    release.require_equal(first, second)
    second.write_bytes(b"sane")
    with pytest.raises(release.ReleaseError):
        release.require_equal(first, second)


def test_a_version_is_never_of_two_packages(tmp_path: Path, release: ModuleType) -> None:
    package = tmp_path / "sunarc_0.4.0_amd64.deb"
    package.write_bytes(b"one")
    record = release.require_new("", [package], "0.4.0")
    assert release.require_new(record, [package], "0.4.0") == record
    package.write_bytes(b"other")
    with pytest.raises(release.ReleaseError):
        release.require_new(record, [package], "0.4.0")
    assert len(release.require_new(record, [package], "0.4.1").splitlines()) == 2


def test_every_bundled_licence_is_in_one_text(tmp_path: Path, release: ModuleType) -> None:
    installed(tmp_path, "beta", licence="MIT", text="Permission is granted")
    installed(tmp_path, "alpha", licence="BSD-3-Clause")
    text = release.licences(tmp_path)
    assert text.index("alpha 1.0") < text.index("BSD-3-Clause") < text.index("beta 1.0")
    assert "Permission is granted" in text
    installed(tmp_path, "gamma")
    with pytest.raises(release.ReleaseError):
        release.licences(tmp_path)


def test_the_bill_of_materials_names_all_and_is_the_same_again(
    tmp_path: Path, release: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("cyclonedx", reason="the set-up is of an older requirements.lock")
    from cyclonedx.model.bom import Bom  # noqa: PLC0415 - skipped without it

    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1764000000")
    for name in ("sunarc", "alpha", "beta_b"):
        installed(tmp_path, name, licence="MIT")
    (tmp_path / "alpha.libs").mkdir()
    (tmp_path / "alpha.libs" / "libc-1.so").write_bytes(b"library")
    text = release.bill_of_materials(tmp_path, "0.4.0")
    assert text == release.bill_of_materials(tmp_path, "0.4.0")
    read = Bom.from_json(json.loads(text))  # type: ignore[attr-defined] # its serializer makes it
    assert {one.name for one in read.components} == {"alpha", "beta_b", "libc-1.so"}
    assert {str(one.purl) for one in read.components if one.purl is not None} == {
        "pkg:pypi/alpha@1.0",
        "pkg:pypi/beta-b@1.0",
    }
    assert read.metadata.component.name == "sunarc"
    installed(tmp_path, "delta", licence="MIT")
    assert json.loads(text)["serialNumber"] != json.loads(release.bill_of_materials(tmp_path, "0.4.0"))["serialNumber"]


def test_the_checksums_are_those_of_sha256sum(tmp_path: Path, release: ModuleType) -> None:
    (tmp_path / "reports").mkdir()
    (tmp_path / "reports" / "booted.txt").write_text("passed")
    (tmp_path / "a.deb").write_bytes(b"package")
    (tmp_path / "SHA256SUMS").write_text(release.checksums(tmp_path))
    check = ["sha256sum", "--check", "--strict", "SHA256SUMS"]
    subprocess.run(check, cwd=tmp_path, check=True, capture_output=True)
    (tmp_path / "a.deb").write_bytes(b"another")
    assert subprocess.run(check, cwd=tmp_path, check=False, capture_output=True).returncode == 1


def test_the_command_wants_a_version_or_the_files_alone(root: Path) -> None:
    for arguments in ([], ["0.4.0", "--files"]):
        command: list[str | Path] = [sys.executable, root / "deploy" / "release.py", *arguments]
        assert subprocess.run(command, capture_output=True, check=False).returncode == 2
