"""The steps of deploy/release: changelog, two builds, bill of materials, licences, checksums."""

from __future__ import annotations

import argparse
import datetime as dt
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Sequence
from importlib.metadata import PathDistribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSION = re.compile(r"\d+\.\d+\.\d+")
STATED = re.compile(r'^version = "([^"]+)"$', re.MULTILINE)
UNRELEASED = "## [Unreleased]"
PLACE = Path("usr/lib/sunarc/site")
REPORTS = ("docs/booted.md", "docs/campaign.md")
"""Reports that `tests/release/run` wrote of its last runs."""
TEXTS = re.compile(r"(?i)(licen[cs]e|copying|notice|copyright|authors)")


class ReleaseError(Exception):
    """Why there is no release."""


def cut(changelog: str, version: str, date: str) -> str:
    """Return a changelog whose unreleased part is a version's.

    Raises
    ------
    ReleaseError
        Where nothing is unreleased, or the version stands there.
    """
    if f"\n## [{version}]" in changelog:
        raise ReleaseError(f"CHANGELOG.md has {version} already")
    before, found, after = changelog.partition(f"{UNRELEASED}\n")
    part = after.partition("\n## [")[0]
    if not found or not part.strip():
        raise ReleaseError("CHANGELOG.md: nothing is unreleased")
    return f"{before}{UNRELEASED}\n\n## [{version}] - {date}\n{after}"


def with_version(project: str, version: str) -> str:
    """Return a pyproject.toml of another version.

    Raises
    ------
    ReleaseError
        Where the version is no release, or not the one that the development is of.
    """
    found = STATED.search(project)
    if VERSION.fullmatch(version) is None or found is None:
        raise ReleaseError(f"{version!r} is not a release: three numbers")
    if found[1] != f"{version}.dev0":
        raise ReleaseError(f"pyproject.toml has {found[1]}; a release of {version} comes after {version}.dev0")
    return project.replace(found[0], f'version = "{version}"', 1)


def sha256(path: Path) -> str:
    """Return a file's sum."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def require_equal(first: Path, second: Path) -> None:
    """Raise ReleaseError where two builds differ."""
    if sha256(first) != sha256(second):
        raise ReleaseError(f"{first.name}: two builds of one commit differ")


def require_new(record: str, files: Sequence[Path], version: str) -> str:
    """Return the record of releases with a version's files.

    Raises
    ------
    ReleaseError
        Where the version is of other files there.
    """
    words = [line.split() for line in record.splitlines()]
    known = {line[1]: line[2] for line in words if line[:1] == [version]}
    lines = []
    for file in files:
        found = sha256(file)
        if known.get(file.name, found) != found:
            raise ReleaseError(f"{file.name}: {version} is released, of other bytes; take the next version")
        if file.name not in known:
            lines.append(f"{version} {file.name} {found}\n")
    return record + "".join(lines)


def distributions(site: Path) -> list[PathDistribution]:
    """Return what is installed in a folder, by name."""
    found = [PathDistribution(path) for path in site.glob("*.dist-info")]
    return sorted(found, key=lambda one: one.metadata["Name"].lower())


def licence_of(one: PathDistribution) -> str:
    """Return what a distribution says of its licence: an expression, a field, or its classifiers."""
    metadata = one.metadata.json
    stated = str(metadata.get("license_expression", ""))
    if not stated:
        classified = [line.rpartition(" :: ")[2] for line in metadata.get("classifier", []) if "License ::" in line]
        field = str(metadata.get("license", "")).strip()
        stated = ", ".join(classified) or (field if "\n" not in field and len(field) < 100 else "see its text")
    return stated or "not stated"


def licences(site: Path) -> str:
    """Return one text of the licences of all that is installed in a folder.

    Raises
    ------
    ReleaseError
        Where a distribution has neither a statement nor a text.
    """
    parts = []
    for one in distributions(site):
        folder = Path(str(one.locate_file(""))) / f"{Path(str(one._path)).name}"  # noqa: SLF001 - the folder itself
        texts = sorted(path for path in folder.rglob("*") if path.is_file() and TEXTS.search(path.name))
        stated = licence_of(one)
        if stated == "not stated" and not texts:
            raise ReleaseError(f"{one.metadata['Name']}: has no licence, neither a statement nor a text")
        head = f"{one.metadata['Name']} {one.version}\nLicence: {stated}\n"
        bodies = [f"--- {path.relative_to(folder)}\n{path.read_text('utf-8', 'replace').rstrip()}\n" for path in texts]
        parts.append(head + "".join(bodies))
    return f"\n{'=' * 78}\n\n".join(parts)


def bill_of_materials(site: Path, version: str) -> str:
    """Return the CycloneDX document (JSON) of what is installed in a folder; the same bytes for the same content.

    Libraries that wheels bring (FFmpeg, OpenSSL, OpenBLAS, …) are listed as files with their sums.
    """
    from cyclonedx.model import HashAlgorithm, HashType  # noqa: PLC0415 - of the development's environment
    from cyclonedx.model.bom import Bom  # noqa: PLC0415 - of the development's environment
    from cyclonedx.model.component import Component, ComponentType  # noqa: PLC0415 - same
    from cyclonedx.model.license import DisjunctiveLicense  # noqa: PLC0415 - same
    from cyclonedx.output.json import JsonV1Dot5  # noqa: PLC0415 - same
    from packageurl import PackageURL  # noqa: PLC0415 - same

    every = distributions(site)
    content = " ".join(f"{one.metadata['Name']}=={one.version}" for one in every)
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"sunarc {version} {content}"))
    for one in every:
        name = one.metadata["Name"]
        component = Component(
            name=name,
            version=one.version,
            type=ComponentType.LIBRARY,
            bom_ref=f"{name.lower()}=={one.version}",
            purl=PackageURL("pypi", None, name.lower().replace("_", "-"), one.version),
            licenses=[DisjunctiveLicense(name=licence_of(one))],
        )
        if name == "sunarc":
            component.type = ComponentType.APPLICATION
            bom.metadata.component = component
        else:
            bom.components.add(component)
    for path in sorted(path for path in site.glob("*.libs/*") if path.is_file() and not path.is_symlink()):
        bom.components.add(
            Component(
                name=path.name,
                type=ComponentType.FILE,
                bom_ref=str(path.relative_to(site)),
                hashes=[HashType(alg=HashAlgorithm.SHA_256, content=sha256(path))],
            )
        )
    epoch = int(os.environ.get("SOURCE_DATE_EPOCH", "0"))
    bom.metadata.timestamp = dt.datetime.fromtimestamp(epoch, dt.UTC)
    if bom.metadata.component is not None:
        bom.register_dependency(bom.metadata.component, bom.components)
    return str(JsonV1Dot5(bom).output_as_string(indent=1)) + "\n"


def checksums(folder: Path) -> str:
    """Return the lines of SHA256SUMS, as `sha256sum --check` reads them."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    return "".join(f"{sha256(path)}  {path.relative_to(folder)}\n" for path in files)


def run(*command: str | Path) -> str:
    """Run a command at the repository's root, and return the last line that it prints.

    Raises
    ------
    ReleaseError
        Where it fails.
    """
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"{command[0]} failed")
    return (done.stdout.strip().splitlines() or [""])[-1]


def built_twice(work: Path, version: str) -> list[Path]:
    """Return package, wheel and the client's wheel of HEAD, each built twice; equal, or there is no release."""
    kept: list[list[Path]] = []
    for number in ("first", "second"):
        folder = work / number
        folder.mkdir()
        package = Path(shutil.move(run(ROOT / "deploy" / "build-deb"), folder))
        # the sources as they are committed, elsewhere each time: a path in the wheel would show
        source, archive = folder / "source", folder / "source.tar"
        source.mkdir()
        run("git", "archive", "--output", archive, "HEAD")
        run("tar", "-x", "-C", source, "-f", archive)
        project = source / "pyproject.toml"
        project.write_text(STATED.sub(f'version = "{version}"', project.read_text("utf-8"), count=1), "utf-8")
        for built in (source, source / "client"):
            run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, built)
        kept.append([package, *sorted(folder.glob("*.whl"))])
    for first, second in zip(*kept, strict=True):
        require_equal(first, second)
    return kept[0]


def require_committed() -> None:
    """Raise ReleaseError where something is changed and not committed."""
    if run("git", "status", "--porcelain", "--untracked-files=no"):
        raise ReleaseError("what is changed and not committed would be missing: commit it, or put it away")


def files_of(out: Path) -> None:
    """Make the files of HEAD's version."""
    os.environ.pop("KERNELS_KEPT", None)  # what is built twice is compiled twice
    os.environ["SOURCE_DATE_EPOCH"] = run("git", "log", "-1", "--format=%ct")
    version = run(ROOT / "deploy" / "build-deb", "--version").replace("~", ".")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        made = [Path(shutil.copy(file, out)) for file in built_twice(work, version)]
        run("dpkg-deb", "--extract", made[0], work / "package")
        site = work / "package" / PLACE
        (out / "licences.txt").write_text(licences(site), "utf-8")
        (out / "sunarc.cdx.json").write_text(bill_of_materials(site, version), "utf-8")
    for report in REPORTS:
        shutil.copy(ROOT / report, out)
    if VERSION.fullmatch(version):
        record = ROOT / "deploy" / "releases.txt"
        record.write_text(require_new(record.read_text("utf-8") if record.exists() else "", made, version), "utf-8")
    (out / "SHA256SUMS").write_text(checksums(out), "utf-8")
    print(out)


def committed(version: str, date: str) -> None:
    """Commit a release: its changelog and its version, or leave all as it was."""
    before = {
        path: (ROOT / path).read_text("utf-8") for path in ("pyproject.toml", "CHANGELOG.md", "docs/openapi.json")
    }
    project, changelog, routes = before.values()
    texts = with_version(project, version), cut(changelog, version, date), routes.replace(f"{version}.dev0", version)
    try:
        for path, text in zip(before, texts, strict=True):
            (ROOT / path).write_text(text, "utf-8")
        run("git", "commit", "--quiet", "--message", f"Version {version}", "--", *before)
    except BaseException:
        for path, text in before.items():
            (ROOT / path).write_text(text, "utf-8")
        raise


def main(arguments: Sequence[str] | None = None) -> int:
    """Make a release, or its files alone."""
    parser = argparse.ArgumentParser(prog="deploy/release", description=__doc__)
    parser.add_argument("version", nargs="?")
    parser.add_argument("--files", action="store_true", help="of the version that HEAD has; nothing is committed")
    parser.add_argument("--date", type=dt.date.fromisoformat, default=dt.datetime.now(dt.UTC).date())
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args(arguments)
    if (chosen.version is None) != chosen.files:
        parser.error("give a version, or --files")
    done = ""
    try:
        require_committed()
        if chosen.version is not None:
            committed(chosen.version, chosen.date.isoformat())
            done = f"; version {chosen.version} is committed: repair, then deploy/release --files"
        name = chosen.version or run(ROOT / "deploy" / "build-deb", "--version")
        files_of(chosen.out or ROOT / "dist" / f"release-{name}")
    except ReleaseError as error:
        print(f"release: {error}{done}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
