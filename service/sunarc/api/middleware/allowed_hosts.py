"""Which names this service answers to: a page whose own name was rebound to this address gets nothing from it."""

from __future__ import annotations

import re
import socket
from http import HTTPStatus
from ipaddress import ip_address

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from sunarc.api.middleware.rate_limit import is_always_answered
from sunarc.api.options import ApiOptions
from sunarc.api.problems import Fault, problem_response

_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\[\]]+)(?::[0-9]{1,5})?")


def host_names(options: ApiOptions) -> frozenset[str]:
    """Return the names that are answered: localhost, the name bound to, the host's own, and those that are set."""
    host_name = socket.gethostname()
    names = ("localhost", options.host, host_name, host_name.partition(".")[0], *options.allowed_hosts)
    return frozenset(name.lower().rstrip(".") for name in names if name)


class AllowedHosts:
    """Refuses requests (421) whose Host header has a name that is not this service's.

    In a DNS rebinding attack the browser sends the attacker's name. Addresses are always answered: an address cannot
    be rebound, and clients behind a port forwarding use one that the host does not know. A request without the
    header is none of a browser's.

    Parameters
    ----------
    app : what is behind it.
    names : those that are answered, in lower case.
    """

    def __init__(self, app: ASGIApp, *, names: frozenset[str]) -> None:
        self._app = app
        self._names = names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] == "http" and not is_always_answered(scope):
            host = Headers(scope=scope).get("host", "")
            if host and not self._is_allowed(host):
                await _refusal(scope["path"], host)(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _is_allowed(self, host: str) -> bool:
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = found[1].lower().rstrip(".")
        return name in self._names or name.endswith(".localhost") or _is_address(name.strip("[]"))


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _refusal(path: str, host: str) -> ASGIApp:
    fault = Fault(
        field="host",
        problem=f"{host[:64]!r} is not a name of this service",
        remedy="ask by its address, or add the name to api.allowed_hosts",
    )
    status = HTTPStatus.MISDIRECTED_REQUEST
    return problem_response(status, path=path, detail=f"{fault.field}: {fault.problem}; {fault.remedy}", errors=[fault])
