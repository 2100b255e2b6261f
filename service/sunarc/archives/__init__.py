"""Archives of images: a folder into the service's archive, or years of several cameras to epochs and calibrations.

`run` the entry of `sunarc reanalyse`, `ingest` that of `sunarc ingest` · `sources` where files are, `image_files` the
images in them, `image_times` when they were taken · `index` which images are whose · `look` what a worker does with
images, `cluster` workers on Dask · `ledger` what is done already · `passes` both passes · `consensus` where the sun
should be · `states` when a camera was moved or changed, or its clock was wrong · `fit` calibrations · `nights` stars ·
`results` the tables, `report` the page. The processes that look at images load no more than they need.
"""
