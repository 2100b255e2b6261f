"""HTTP service: calibrations, directions, sun, days, events, health, and the dashboard.

`app` builds the application and its description · `routes` one module per resource · `schemas` bodies of requests and
answers · `middleware` limits, hosts and tokens, in front of every route · `arrays` bodies of many rows · `bulk`
their answers · `context` shared state of the routes · `problems` errors as RFC 9457 problem documents ·
`static` the pages.
"""
