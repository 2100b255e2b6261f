"""Archives of images: years of several cameras to epochs and calibrations, or a folder into a service's archive.

`run` the entry of `sunarc reanalyse`, `ingest` that of `sunarc ingest` · `cluster` workers on Dask, `pool` processes of
this machine · `ledger` the answers that are kept · `passes` both passes over the images · `states` when a camera was
moved or changed, or its clock was wrong · `fit` calibrations · `nights` stars · `results` tables, `report` the page.
"""
