"""The bundle on a Debian that has neither a network nor anything of what the package needs."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from .machine import Machine, build_tree, run

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1800)]

ROOT = Path(__file__).parents[2]
SETTINGS = """
name = "roof"
[site]
latitude = 36.6
longitude = -97.5
altitude = 318.0
[camera]
address = "192.0.2.1"
"""


@pytest.fixture
def no_route() -> Iterator[str]:
    """Return a network namespace with nothing in it."""
    name = f"sunarc-{os.getpid()}-alone"
    run("ip", "netns", "add", name)
    run("ip", "-n", name, "link", "set", "lo", "up")
    yield name
    run("ip", "netns", "delete", name)


@pytest.fixture
def bare_tree(tmp_path: Path) -> Path:
    """Return a Debian with systemd and little else, the bundle unpacked in its /opt."""
    work = os.environ.get("SUNARC_BOOTED")
    if work is None:
        pytest.skip("needs a machine to boot: run deploy/test-booted")
    tree = tmp_path / "bare"
    build_tree(tree, packages="systemd-sysv,dbus,udev")
    bundle = run(ROOT / "deploy" / "bundle", Path(work) / "sunarc.deb", timeout_s=900.0).split()[-1]
    run("tar", "-xf", bundle, "-C", tree / "opt")
    Path(bundle).unlink()
    (tree / "opt" / "roof.toml").write_text(SETTINGS)
    return tree


def test_a_bare_debian_without_a_route_installs_from_the_bundle_alone(bare_tree: Path, no_route: str) -> None:
    machine = Machine(f"sunarc-{os.getpid()}-bare", bare_tree, no_route)
    machine.boot()
    try:
        assert machine("cat", "/proc/net/route").count("\n") == 1  # the headings
        assert machine.call("sh", "-c", "command -v python3").stdout == ""
        said = machine("sh", "-c", "/opt/sunarc_*/install --config /opt/roof.toml", timeout_s=1200.0)
        assert "install: ready" in said
        assert machine("systemctl", "is-active", "sunarc").strip() == "active"
        assert machine.call("apt-get", "check").returncode == 0
    except subprocess.TimeoutExpired as late:
        pytest.fail(f"{late.output}")
    finally:
        machine.stop()
