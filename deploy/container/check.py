#!/usr/bin/env python3
"""Checks an OCI image: its layout, every blob against its digest, and that it does not run as root.

deploy/container/check.py IMAGE.oci.tar
"""

from __future__ import annotations

import hashlib
import json
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any


class Image:
    """An OCI image in an archive."""

    def __init__(self, archive: tarfile.TarFile) -> None:
        self._archive = archive

    def read(self, name: str) -> bytes:
        """Return a file of the layout."""
        file = self._archive.extractfile(name)
        if file is None:
            raise SystemExit(f"{name} is no file")
        return file.read()

    def blob(self, descriptor: dict[str, Any]) -> bytes:
        """Return a blob whose size and digest are those of its descriptor."""
        digest = str(descriptor["digest"])
        content = self.read(f"blobs/{digest.replace(':', '/')}")
        if len(content) != descriptor["size"] or f"sha256:{hashlib.sha256(content).hexdigest()}" != digest:
            raise SystemExit(f"blob {digest} is not what its descriptor says")
        return content


def checked(image: Image) -> Iterator[str]:
    """Yield what was found right; SystemExit for what is wrong."""
    if json.loads(image.read("oci-layout")) != {"imageLayoutVersion": "1.0.0"}:
        raise SystemExit("oci-layout is of another version")
    (found,) = json.loads(image.read("index.json"))["manifests"]
    manifest = json.loads(image.blob(found))
    config = json.loads(image.blob(manifest["config"]))
    layers = [image.blob(layer) for layer in manifest["layers"]]
    yield f"manifest {found['digest']}: config and {len(layers)} layer(s), {sum(map(len, layers)) / 1e6:.0f} MB"
    settings = config["config"]
    if settings.get("User") in (None, "", "0", "root", "0:0"):
        raise SystemExit("the image runs as root")
    yield f"{config['architecture']}, user {settings['User']}, {settings['Entrypoint']} {settings['Cmd']}"


def main() -> None:
    """Check the image that the command line names."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    with tarfile.open(Path(sys.argv[1])) as archive:
        for line in checked(Image(archive)):
            print(line)


if __name__ == "__main__":
    main()
