"""Compiles the module `sunarc._kernels` where the wheel is built, and beside the sources where these are installed."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
MULTIARCH = sysconfig.get_config_var("MULTIARCH")
OTHER = os.environ.get("SUNARC_KERNELS_FOR", "")
"""An architecture to compile for that is not this computer's, as GNU names it: aarch64."""
KEPT = os.environ.get("KERNELS_KEPT", "")
"""A folder where what was compiled is kept for the next time that the same is asked: tests build four times."""


class CompiledModule(BuildHookInterface[Any]):
    """Adds the compiled module to a wheel; the wheel is then of one interpreter and one architecture."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile it; `version` is "editable" where the sources themselves are installed."""
        if self.target_name != "wheel":
            return
        package = Path(self.root, "service", "sunarc")
        self.folder = tempfile.TemporaryDirectory()
        compiled = _compiled(Path(self.root, "service", "kernels"), Path(self.folder.name))
        build_data["pure_python"], build_data["infer_tag"] = False, not OTHER
        if OTHER:
            python = f"cp{PYTHON.replace('.', '')}"
            build_data["tag"] = f"{python}-{python}-linux_{OTHER}"
        if version == "editable":
            for stale in package.glob("_kernels*.so"):
                stale.unlink()
            package.joinpath(compiled.name).write_bytes(compiled.read_bytes())
        else:
            name = compiled.name.replace(MULTIARCH, f"{OTHER}-linux-gnu") if OTHER else compiled.name
            build_data["force_include"][str(compiled)] = f"sunarc/{name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled, which the wheel holds now."""
        if self.target_name == "wheel":
            self.folder.cleanup()


def _compiled(sources: Path, folder: Path) -> Path:
    """Return the module, compiled in a folder, or as it was kept."""
    sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(sources.iterdir()) if path.is_file()]
    asked = " ".join([*sums, version("nanobind"), sys.version, OTHER])
    kept = Path(KEPT, hashlib.sha256(asked.encode()).hexdigest()) if KEPT else folder
    for module in kept.glob("_kernels*.so"):
        return module
    options = ["-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}"]
    if OTHER:
        options += _for_other(folder)
    subprocess.run(["cmake", "-S", sources, "-B", folder, *options], check=True, stdout=sys.stderr)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=sys.stderr)
    (module,) = folder.glob("_kernels*.so")
    if KEPT:
        kept.mkdir(parents=True, exist_ok=True)
        os.replace(shutil.copy(module, kept / f"new-{os.getpid()}"), kept / module.name)  # noqa: PTH105 - at once, whole
    return module


def _for_other(folder: Path) -> list[str]:
    """Return what cmake takes to compile for another 64-bit architecture with Debian's compiler for it.

    Of Python's headers one differs by architecture, in name alone: they state the sizes of C's types.
    """
    header = folder / "include" / f"{OTHER}-linux-gnu" / f"python{PYTHON}" / "pyconfig.h"
    header.parent.mkdir(parents=True)
    own = Path(sysconfig.get_paths()["include"]).parent / MULTIARCH / header.parent.name
    header.write_text(f'#include "{own}/pyconfig.h"\n')
    return [
        f"-DCMAKE_CXX_COMPILER={OTHER}-linux-gnu-g++",
        f"-DCMAKE_CXX_FLAGS=-I{folder}/include",
    ]
