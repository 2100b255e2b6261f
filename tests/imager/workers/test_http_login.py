"""Logins that a camera asks for: against the examples of RFC 7616, and what cameras send that is none."""

from __future__ import annotations

import secrets

import pytest

from sunarc.imager.runtime.http_exchange import authorization, challenges_in, offers

LOGIN = ("Mufasa", "Circle of Life")
NONCE = "7ypf/xlj9XXwfDPEoM4URrv/xwf94BcCAzFZH4GiTo0v"
ONCE = "f2/wE4q74E6zIJEtWaHKaf5wv/H5QzzpXusqGemxURZJ"
MD5, SHA256 = (
    f'Digest realm="http-auth@example.org", qop="auth, auth-int", algorithm={name}, nonce="{NONCE}", '
    'opaque="FQhe/qaU925kfnzjCev0ciny7QMkPqMAFRtzCUYo5tdS"'
    for name in ("MD5", "SHA-256")
)


def answered(*lines: str) -> str | None:
    return authorization(LOGIN, challenges_in(lines), method="GET", uri="/dir/index.html")


@pytest.mark.parametrize(
    ("lines", "response"),
    [
        ([MD5], "8ca523f5e9506fed4657c9700eebdbec"),
        ([SHA256], "753927fa0e85d155564e2e272a28d1802ca10daf4496794697cf8db5856cb6c1"),
        ([SHA256, MD5], "753927fa0e85d155564e2e272a28d1802ca10daf4496794697cf8db5856cb6c1"),
        ([SHA256.replace("SHA-256", "SHA3-512"), MD5], "8ca523f5e9506fed4657c9700eebdbec"),
        ([MD5.replace("MD5", '"md5"')], "8ca523f5e9506fed4657c9700eebdbec"),
        ([f'Basic realm="x", {MD5}'], "8ca523f5e9506fed4657c9700eebdbec"),
        ([MD5, 'Basic realm="x"'], "8ca523f5e9506fed4657c9700eebdbec"),
        ([f'{MD5}, Basic realm="x"'], "8ca523f5e9506fed4657c9700eebdbec"),
    ],
)
def test_digest_is_answered_as_its_standard_computes_it(
    lines: list[str], response: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda _: ONCE)
    given = answered(*lines)
    assert given is not None
    (challenge,) = challenges_in([given])
    assert challenge.scheme == "digest"
    assert challenge.parameters["response"] == response
    assert challenge.parameters["opaque"] == "FQhe/qaU925kfnzjCev0ciny7QMkPqMAFRtzCUYo5tdS"
    assert (challenge.parameters["qop"], challenge.parameters["nc"]) == ("auth", "00000001")


@pytest.mark.parametrize(
    "lines",
    [
        ["Digest foo"],
        ['Digest realm="c", nonce="n", algorithm=SHA3-512', 'Basic realm="c"'],
        ['Basic realm="c", Digest realm="c", nonce="n", qop="unknown"'],
        ["Negotiate, NTLM"],
    ],
)
def test_the_password_is_not_sent_where_no_challenge_is_safe(lines: list[str]) -> None:
    assert answered(*lines) is None


@pytest.mark.parametrize("lines", [['Basic realm="c"'], ['bearer, BASIC realm="c"'], []])
def test_basic_is_for_those_that_offer_nothing_better(lines: list[str]) -> None:
    assert answered(*lines) == "Basic TXVmYXNhOkNpcmNsZSBvZiBMaWZl"


def test_an_empty_qop_is_that_of_the_first_standard() -> None:
    """The example of RFC 2069 with the value of its errata."""
    line = 'Digest realm="testrealm@host.com", nonce="dcd98b7102dd2f0e8b11d0f600bfb0c093", qop='
    given = authorization(("Mufasa", "CircleOfLife"), challenges_in([line]), method="GET", uri="/dir/index.html")
    assert given is not None
    assert 'response="1949323746fe6a43ef61f9606e7febea"' in given
    assert "cnonce" not in given


def test_a_message_names_what_is_offered() -> None:
    assert offers(challenges_in([f'Basic realm="x", {SHA256}', MD5, MD5])) == "Basic, Digest SHA-256, Digest MD5"
    assert offers([]) == "nothing"
