from __future__ import annotations

import logging
import sqlite3
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from sunarc.common.errors import ConfigurationError, InputError, OutsideError, SunarcError
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:
    from tests.fixtures.served import Made

SHAPE = {"type", "title", "status", "detail", "instance", "errors"}


def check_shape(answer: httpx.Response, status: int, path: str) -> dict[str, Any]:
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert set(problem) == SHAPE
    assert (problem["status"], problem["instance"]) == (status, path)
    assert problem["type"].startswith("urn:sunarc:problem:")
    assert all(set(error) == {"field", "problem", "remedy"} for error in problem["errors"])
    return problem


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing/here", 404),
        ("GET", "/static/../app.py", 404),
        ("GET", "/static/%2e%2e/app.py", 404),
        ("GET", "/v1/calibrations/unknown", 404),
        ("GET", "/v1/refits/unknown", 404),
        ("DELETE", "/v1/calibration", 405),
        ("GET", "/v1/back-project", 405),
        ("POST", "/v1/back-project", 422),
        ("GET", "/v1/sun?at=never", 422),
        ("POST", "/v1/refits", 401),
    ],
)
def test_every_refusal_has_one_shape(made: Made, method: str, path: str, status: int) -> None:
    answer = made.client.request(method, path)
    problem = check_shape(answer, status, answer.request.url.path)
    assert problem["detail"]
    if status == 405:
        allowed = answer.headers["allow"].split(", ")
        assert allowed
        assert all(one in problem["errors"][0]["remedy"] for one in allowed if one != "HEAD")


def test_a_body_that_announces_too_much_is_refused_unread(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(max_body_bytes=100)
    answer = made.client.post("/v1/back-project", content=b" " * 101)
    problem = check_shape(answer, 413, "/v1/back-project")
    assert problem["errors"][0] == {
        "field": "body",
        "problem": "larger than 100 bytes",
        "remedy": "send it in parts",
    }


def test_a_body_that_does_not_announce_its_size_is_cut_off(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(max_body_bytes=1000)
    sent = 0

    async def endless() -> AsyncIterator[bytes]:
        nonlocal sent
        while sent < 10**6:
            sent += 100
            yield b" " * 100

    answer = made.client.post("/v1/back-project", content=endless(), headers={"content-type": "application/json"})
    check_shape(answer, 413, "/v1/back-project")
    assert sent <= 1200


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError(field="x", problem="is wrong", remedy="mend it"), 422),
        (OutsideError("the disk is full"), 503),
        (ConfigurationError("the settings are gone"), 500),
        (SunarcError("something"), 500),
        (ZeroDivisionError("a bug"), 500),
    ],
)
def test_every_error_has_its_answer(
    made: Made, error: Exception, status: int, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(type(made.archive.events), "find", fail)
    with caplog.at_level(logging.CRITICAL):
        answer = made.client.get("/v1/events")
    problem = check_shape(answer, status, "/v1/events")
    assert "Traceback" not in answer.text
    assert ("a bug" in problem["detail"]) is False


def test_a_locked_database_is_a_503_and_the_next_request_is_answered(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "0.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("ALTER TABLE event RENAME TO hidden")
        assert made.client.get("/v1/events").status_code == 503
        other.execute("ALTER TABLE hidden RENAME TO event")
    assert made.client.get("/v1/events").status_code == 200


@pytest.mark.parametrize("path", ["/", "/v1/status", "/nothing", "/static/dashboard.js"])
def test_browsers_are_told_to_be_strict(made: Made, path: str) -> None:
    headers = made.client.get(path).headers
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize("options", [{"port": 70_000}, {"max_points": 0}, {"max_body_bytes": -1}])
def test_options_out_of_bounds_are_refused(options: dict[str, int]) -> None:
    with pytest.raises(InputError, match=r"api\."):
        ApiOptions(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("content", "match"), [(None, "No such file"), ("short", "at least 16 characters")])
def test_a_token_file_that_is_none_stops_the_start(
    make: Any,  # noqa: ANN401 - a fixture that is a function
    tmp_path: Path,
    content: str | None,
    match: str,
) -> None:
    path = tmp_path / "secret"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigurationError, match=match):
        make(token=False, token_file=path)


def test_long_answers_are_compressed_for_those_who_take_it(made: Made) -> None:
    plain = made.client.get("/v1/sun-points", headers={"accept-encoding": "identity"})
    packed = made.client.get("/v1/sun-points", headers={"accept-encoding": "gzip"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert int(packed.headers["content-length"]) < len(plain.content) / 4
    assert packed.json() == plain.json()
    assert packed.headers["vary"] == "Accept-Encoding"
    assert "content-encoding" not in made.client.get("/healthz", headers={"accept-encoding": "gzip"}).headers
    assert "content-encoding" not in made.client.get("/v1/image/latest", headers={"accept-encoding": "gzip"}).headers


def test_a_path_that_knows_several_methods_lists_them_all(made: Made) -> None:
    for path in ("/v1/refits", "/v1/cameras/roof/refits"):
        assert made.client.request("DELETE", path).headers["allow"].split(", ") == ["GET", "HEAD", "POST"]
    assert made.client.request("DELETE", "/").headers["allow"]


@pytest.mark.parametrize(
    ("path", "body", "named"),
    [
        ("/v1/sun?at=2013-05-13T18:00:00", None, "2013-05-13T18:30:00Z"),
        ("/v1/sun?at=1368469800", None, "date -u -d @"),
        ("/v1/sun?at=2013-05-13", None, "2013-05-13T18:30:00Z"),
        ("/v1/sun-points?since=yesterday", None, "2013-05-13T18:30:00Z"),
        ("/v1/geolocate", {"pixels": [[871.0, 883.0]]}, "add height_m"),
        ("/v1/geolocate", {"height_m": 1500.0}, "give pixels and height_m"),
        ("/v1/project", {"zenith_deg": [30.0]}, "give zenith_deg and azimuth_deg"),
    ],
)
def test_a_wrong_time_and_a_missing_height_have_a_remedy_to_type(
    made: Made, path: str, body: dict[str, Any] | None, named: str
) -> None:
    answer = made.client.get(path) if body is None else made.client.post(path, json=body)
    (fault,) = check_shape(answer, 422, answer.request.url.path)["errors"]
    assert named in fault["remedy"]
    assert "openapi.json" not in fault["remedy"]


@pytest.mark.parametrize(
    ("at", "written"),
    [
        ("1368469800", "2013-05-13T18:30:00Z"),
        ("1368469800.5", "2013-05-13T18:30:00Z"),
        ("1368469800000", "2013-05-13T18:30:00Z"),
        ("1764338700", "2025-11-28T14:05:00Z"),
    ],
)
def test_a_unix_time_is_answered_with_the_same_time_to_type(made: Made, at: str, written: str) -> None:
    (fault,) = check_shape(made.client.get(f"/v1/sun?at={at}"), 422, "/v1/sun")["errors"]
    assert f"write it as {written} " in fault["remedy"]
    body = {"pixels": [[871.0, 883.0]], "height_m": 1500.0, "at": [float(at)]}
    (fault,) = check_shape(made.client.post("/v1/geolocate", json=body), 422, "/v1/geolocate")["errors"]
    assert (fault["field"], f"write it as {written} " in fault["remedy"]) == ("at[0]", True)


def test_a_compact_date_is_no_unix_time(made: Made) -> None:
    for at in ("20130513", "201305131830"):
        (fault,) = check_shape(made.client.get(f"/v1/sun?at={at}"), 422, "/v1/sun")["errors"]
        assert "is not a time with its date" in fault["problem"]
