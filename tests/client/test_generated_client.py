"""A client generated from the OpenAPI document: it has every operation, compiles, and works against the service.

The generator, openapi-python-client, needs another typer than requirements.lock pins: uv installs it into an
environment of its own, in a second or two. Where the package index cannot be reached, the tests
that need it are skipped.
"""

from __future__ import annotations

import compileall
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.fixtures.served import archives, make
from tests.imager.web.test_event_stream import serving

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

__all__ = ["archives", "make"]

DOCUMENT = Path(__file__).parents[2] / "docs" / "openapi.json"
CONFIG = Path(__file__).with_name("generated_client.yml")
GENERATOR = "openapi-python-client==0.29.1"
PROGRAM = """
import json, sys
sys.path.insert(0, sys.argv[1])
from imager import Client, models
from imager.api.calibrations import calibrations
from imager.api.directions import back_project, geolocate, project
from imager.api.health import status
from imager.api.images import sun_mask

client = Client(base_url=sys.argv[2])
looks = back_project.sync(client=client, body=models.BackProjectRequest(pixels=[[871.96, 700.0]]))
angles = models.ProjectRequest(zenith_deg=looks.zenith_deg, azimuth_deg=looks.azimuth_deg)
lands = project.sync(client=client, body=angles)
found = geolocate.sync(client=client, body=models.GeolocateRequest(pixels=[[871.96, 700.0]], height_m=1500.0))
refused = back_project.sync_detailed(client=client, body=models.BackProjectRequest(pixels=[[1.0]]))
mask = sun_mask.sync(client=client)
print(json.dumps({
    "pixel": lands.pixels[0],
    "height": found.cloud.up_m[0],
    "camera": status.sync(client=client).camera_name,
    "ids": [one.id for one in calibrations.sync(client=client).calibrations],
    "refused": [int(refused.status_code), refused.parsed.errors[0].field],
    "mask": mask.payload.read(8).hex() if hasattr(mask, "payload") else mask[:8].hex(),
}))
"""


def schemas(part: Any) -> Iterator[dict[str, Any]]:  # noqa: ANN401 - JSON
    if isinstance(part, dict):
        yield part
        for inner in part.values():
            yield from schemas(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from schemas(inner)


def test_the_document_has_no_alternatives_that_generators_cannot_read() -> None:
    alternatives = [
        one
        for schema in schemas(json.loads(DOCUMENT.read_text())["components"]["schemas"])
        for name in ("oneOf", "anyOf")
        for one in (schema[name] if isinstance(schema.get(name), list) else ())
    ]
    assert len(alternatives) > 50
    assert [one for one in alternatives if not {"type", "$ref", "const", "enum"} & one.keys()] == []


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the programs of an environment that has the generator."""
    folder, uv = tmp_path_factory.mktemp("generator"), Path(sys.executable).with_name("uv")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    command = [str(uv), "pip", "install", "--quiet", "--python", str(folder / "bin" / "python"), GENERATOR]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120.0)
    if done.returncode != 0:
        pytest.skip(f"{GENERATOR} cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return folder / "bin"


@pytest.fixture(scope="module")
def generated(programs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generated") / "imager"
    command = [str(programs / "openapi-python-client"), "generate", "--path", str(DOCUMENT), "--meta", "none"]
    command += ["--output-path", str(folder)]
    done = subprocess.run([*command, "--config", str(CONFIG)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stdout, done.stdout
    return folder


def test_every_operation_is_there_and_compiles(generated: Path) -> None:
    document = json.loads(DOCUMENT.read_text())
    names = {operation["operationId"] for path in document["paths"].values() for operation in path.values()}
    modules = {path.stem for path in generated.glob("api/*/*.py")} - {"__init__"}
    assert modules == {re.sub(r"\W", "_", name) for name in names}
    assert compileall.compile_dir(generated, quiet=1)


def test_it_works_against_the_service(programs: Path, generated: Path, make: Make) -> None:
    made: Made = make(history="filled")
    with serving(made) as address:
        command = [str(programs / "python"), "-c", PROGRAM, str(generated.parent), address.rstrip("/")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["pixel"] == pytest.approx([871.96, 700.0], abs=1e-6)
    assert found["height"] == pytest.approx(1500.0, abs=1.0)
    assert (found["camera"], found["ids"]) == ("roof", ["second", "refused", "first"])
    assert found["refused"] == [422, "pixels[0]"]
    assert bytes.fromhex(found["mask"]) == b"\x89PNG\r\n\x1a\n"
