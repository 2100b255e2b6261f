"""Detection of a change of camera, clock or site by Bayesian model comparison of the last sightings.

`detect_change` one sighting more · `residual_model` the last sightings and the covariance of their residuals ·
`hypotheses` what may have changed · `cloud_drift` the rival that nothing has · `report` the change in words ·
`values` in and out.
"""
