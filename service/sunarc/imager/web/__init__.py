"""HTTP service: calibrations, directions, sun, days, events, health, and the dashboard.

`app` builds the application, `hub_app` that of a hub · `routes` one module per resource · `schemas` bodies of
requests and answers · `middleware` limits, hosts and tokens, in front of every route · `bulk` requests with many rows ·
`context` what the routes share · `problems` errors as RFC 9457 problem documents · `openapi` the description ·
`static` the pages.
"""
