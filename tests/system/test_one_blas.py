"""OpenCV on scipy's OpenBLAS, as the package has it."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

pytestmark = pytest.mark.system

SCRIPT = Path(__file__).parents[2] / "deploy" / "debian" / "one-blas"
WHEELS = ("cv2", "numpy", "numpy.libs", "scipy.libs", "opencv_python_headless.libs")
SOLVED = """
import sys
sys.path.insert(0, sys.argv[1])
import cv2
import numpy as np
rng = np.random.default_rng(1)
a, b = rng.normal(size=(200, 200)), rng.normal(size=(200, 3))
x = np.linalg.solve(a, b)
for way in (cv2.DECOMP_LU, cv2.DECOMP_SVD, cv2.DECOMP_QR):
    assert np.allclose(cv2.solve(a, b, flags=way)[1], x, rtol=1e-9), way
assert np.allclose(cv2.solve(a @ a.T, a @ b, flags=cv2.DECOMP_CHOLESKY)[1], np.linalg.solve(a @ a.T, a @ b), rtol=1e-6)
assert np.allclose(cv2.SVDecomp(a)[0].ravel(), np.linalg.svd(a)[1], rtol=1e-12)
for kind in (np.float32, np.float64):
    product = cv2.gemm(a.astype(kind), a.astype(kind), 1.0, None, 0.0)
    assert np.allclose(product, a @ a, atol=1e-3 if kind is np.float32 else 1e-11), kind
print(*sorted({line.split("/")[-1].split("-")[0].strip() for line in open("/proc/self/maps") if "openblas" in line}))
"""


@pytest.fixture
def site() -> Iterator[Path]:
    """Return a copy of the installed wheels that have to do with it."""
    installed = Path(cv2.__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        for name in WHEELS:
            shutil.copytree(installed / name, Path(folder, name), ignore=shutil.ignore_patterns("__pycache__", "tests"))
        yield Path(folder)


def test_opencv_solves_and_multiplies_with_the_blas_of_scipy_and_carries_none(site: Path) -> None:
    before = sum(file.stat().st_size for file in site.rglob("*"))
    subprocess.run([SCRIPT, site], check=True)
    assert before - sum(file.stat().st_size for file in site.rglob("*")) > 40e6
    command = ["/usr/bin/python3", "-I", "-c", SOLVED, str(site)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["libopenblasp", "libscipy_openblas", "libscipy_openblas64_"]
