from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jsonschema_rs

if TYPE_CHECKING:
    from tests.fixtures.served import Made

COMMITTED = Path(__file__).parents[3] / "docs" / "openapi.json"
REGENERATE = "SUNARC_WRITE_OPENAPI=1 pytest tests/imager/web/test_openapi.py"


def text_of(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def test_the_committed_document_is_the_one_that_is_served(made: Made, write_openapi: bool) -> None:  # noqa: FBT001 - a fixture
    told = text_of(made.client.get("/openapi.json").json())
    if write_openapi:
        COMMITTED.write_text(told)
    assert COMMITTED.read_text() == told, f"the API has changed; see that this is meant, then run: {REGENERATE}"


def test_every_route_is_described(made: Made) -> None:
    paths = made.client.get("/openapi.json").json()["paths"]
    for path, operations in paths.items():
        for method, operation in operations.items():
            assert operation["description"].strip(), (method, path)
            assert operation["tags"], (method, path)


def test_operations_have_short_names_and_known_tags(made: Made) -> None:
    document = made.client.get("/openapi.json").json()
    operations = [one for path in document["paths"].values() for one in path.values()]
    names = [one["operationId"] for one in operations]
    assert len(set(names)) == len(names)
    assert [name for name in names if not re.fullmatch(r"[a-z]+(_[a-z]+)*", name)] == []
    assert {"back_project", "sun_mask", "calibration_by_id", "event_stream", "request_refit"} <= set(names)
    tags = {tag["name"] for tag in document["tags"]}
    assert {tag for one in operations for tag in one["tags"]} == tags


def test_every_answer_has_a_schema(made: Made) -> None:
    for path, operations in made.client.get("/openapi.json").json()["paths"].items():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                assert all(content.get("schema") for content in answer.get("content", {}).values()), (path, status)


def test_every_field_says_what_it_is_and_gives_an_example(made: Made) -> None:
    schemas = made.client.get("/openapi.json").json()["components"]["schemas"]
    for name, schema in schemas.items():
        assert schema["description"].strip(), name
        for field, one in schema.get("properties", {}).items():
            assert one.get("description"), f"{name}.{field}: describe it"
            shown = any(word in json.dumps(one) for word in ('"examples"', '"enum"', '"const"', '"$ref"'))
            assert shown, f"{name}.{field}: give an example"


def test_every_example_is_one(made: Made) -> None:
    document = made.client.get("/openapi.json").json()
    for name, schema in document["components"]["schemas"].items():
        for field, one in schema.get("properties", {}).items():
            checked = jsonschema_rs.validator_for({**one, "components": document["components"]})
            for example in one.get("examples", ()):
                assert checked.is_valid(example), (name, field, example)


def test_every_parameter_says_what_it_is(made: Made) -> None:
    for path, operations in made.client.get("/openapi.json").json()["paths"].items():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                assert parameter.get("description"), f"{path} {parameter['name']}: describe it"


def test_every_number_in_an_answer_names_its_unit_or_is_a_count(made: Made) -> None:
    schemas = made.client.get("/openapi.json").json()["components"]["schemas"]
    units = ("degrees", "px", "µs", " s", "s.", "share", "metres", "bytes", "ratio", "squared", "circle", "count", "sr")
    bare = [
        f"{name}.{field}: {one.get('description')}"
        for name, schema in schemas.items()
        for field, one in schema.get("properties", {}).items()
        if '"number"' in json.dumps(one)
        and not any(unit in one.get("description", "").lower() for unit in units)
        and not field.endswith(("_px", "_s", "_deg", "_m", "_enu"))
    ]
    assert bare == []


def test_every_failure_is_described_as_a_problem(made: Made) -> None:
    document = made.client.get("/openapi.json").json()
    for path, operations in document["paths"].items():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    assert list(answer["content"]) == ["application/problem+json"], (path, status)
    assert "HTTPValidationError" not in json.dumps(document)


def test_a_generated_client_is_not_called_like_ours(made: Made) -> None:
    """Generators call the package after the title, and end it with "client"."""
    title = made.app.openapi()["info"]["title"]
    assert title.lower().replace(" ", "_") + "_client" not in {"sunarc_client", "sunarc"}
