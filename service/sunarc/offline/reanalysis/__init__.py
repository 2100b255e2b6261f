"""An archive of years analysed again: every sun, the epochs of each camera, a calibration for each, a report.

`run` the entry · `plan`, `cameras_file`, `index` which images are whose · `look` what a worker does with a chunk of
images · `cluster` workers on Dask · `ledger` what is done already · `states`, `epochs` when a camera was moved or
changed, or its clock was wrong · `passes` both passes · `fit` calibrations · `horizon` what hides the sun · `results`
the tables · `report` the page.
"""
