"""What deploy/container has for an orchestrator: services of images that are built, settings that exist."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import yaml

from sunarc.imager.settings.reference import all_settings

CONTAINERS = Path(__file__).parents[2] / "deploy/container"
KNOWN = {f"SUNARC_{one.name.upper().replace('.', '__')}" for one in all_settings()} | {"SUNARC_FOLDER__PATH"}


def test_the_services_of_the_compose_file_are_of_images_that_are_built_and_write_nowhere_else() -> None:
    services = yaml.safe_load((CONTAINERS / "compose.yaml").read_text())["services"]
    built = set(re.findall(r"\bname=(\S+)", (CONTAINERS / "build").read_text()))
    assert set(services) == {"db", "migrate", "hub", "imager"}
    for name in ("migrate", "hub", "imager"):
        service = services[name]
        assert service["image"].partition(":")[0] in built
        assert set(service.get("environment", {})) <= KNOWN
    for name in ("hub", "imager"):
        assert services[name]["read_only"] is True
        assert services[name]["cap_drop"] == ["ALL"]
        assert all(port.startswith("127.0.0.1:") for port in services[name]["ports"])


def test_a_package_that_is_not_there_is_refused_before_anything_is_built() -> None:
    tools = {"PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [CONTAINERS / "build", "--imager", "no.deb"], env=tools, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
