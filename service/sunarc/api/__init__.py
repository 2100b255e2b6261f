"""What others see: calibrations, directions, the sun, the record and the service's health over HTTP, and a dashboard.

app.py: `create_app` · served.py: what the routes are handed · calibrations.py, decisions.py, epochs.py,
directions.py, maps.py, geolocation.py, sun.py, record.py, refits.py, cameras.py, health.py: the routes ·
computing.py, arrays.py: questions of many rows · schemas.py, geolocation_schemas.py, record_schemas.py, fields.py,
pages.py: what is asked and answered · problems.py, fault_log.py: every failure as one shape, and faults in the log ·
connections.py, boundary.py, allowed_hosts.py, limits.py, client_address.py, tokens.py, request_bodies.py: what every
request passes before, from the socket inwards · holdings.py, places.py: memory and processors, shared among addresses
· npy_header.py: what a .npy file says of itself · metrics.py: Prometheus · schema.py, glossary.py: the OpenAPI
document · static/: the dashboard.
"""

from sunarc.api.app import create_app
from sunarc.api.middleware.connection_limit import BoundedConnection
from sunarc.api.options import ApiOptions

__all__ = ["ApiOptions", "BoundedConnection", "create_app"]
