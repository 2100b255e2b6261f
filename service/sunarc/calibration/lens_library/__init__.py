"""Lenses of one type: what several cameras say of it, and what a fit or a pose gains from that.

`frame` the coordinates · `lens_type` what is known of a type, and its JSON · `combination` of several cameras ·
`conditioning` of a fit · `joint` fits of several cameras and epochs · `first_pose` from a few sightings ·
`mounting` azimuth and level of a camera.
"""
