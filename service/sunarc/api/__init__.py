"""HTTP service: calibrations, directions, sun, days, events, health, and the dashboard.

`app` builds the application, `hub_app` that of a hub · `routes` one module per resource · `schemas` bodies of
requests and answers · `middleware` limits, hosts and tokens, in front of every route · `bulk` requests with many rows ·
`context` what the routes share · `problems` errors as RFC 9457 problem documents · `openapi` the description ·
`static` the pages.
"""

from sunarc.api.app import create_app
from sunarc.api.hub_app import create_hub_app
from sunarc.api.middleware.authentication import read_token
from sunarc.api.middleware.connection_limit import BoundedConnection
from sunarc.api.options import ApiOptions
from sunarc.api.routes.feed import token_digest
from sunarc.api.routes.fleet import members

__all__ = ["ApiOptions", "BoundedConnection", "create_app", "create_hub_app", "members", "read_token", "token_digest"]
