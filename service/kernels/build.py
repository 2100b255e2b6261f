"""Compiles the module `sunarc._kernels` where the wheel is built, and beside the sources where these are installed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledModule(BuildHookInterface[Any]):
    """Adds the compiled module to a wheel; the wheel is then of one interpreter and one architecture."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile it; `version` is "editable" where the sources themselves are installed."""
        if self.target_name != "wheel":
            return
        package = Path(self.root, "service", "sunarc")
        self.folder = tempfile.TemporaryDirectory()
        for stale in package.glob("_kernels*.so"):
            stale.unlink()
        compiled = _compiled(Path(self.root, "service", "kernels"), Path(self.folder.name))
        build_data["pure_python"], build_data["infer_tag"] = False, True
        if version == "editable":
            package.joinpath(compiled.name).write_bytes(compiled.read_bytes())
        else:
            build_data["force_include"][str(compiled)] = f"sunarc/{compiled.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled, which the wheel holds now."""
        if self.target_name == "wheel":
            self.folder.cleanup()


def _compiled(sources: Path, folder: Path) -> Path:
    """Return the module, compiled in a folder."""
    command = [
        "cmake",
        "-S",
        sources,
        "-B",
        folder,
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    subprocess.run(command, check=True, stdout=sys.stderr)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=sys.stderr)
    (module,) = folder.glob("_kernels*.so")
    return module
