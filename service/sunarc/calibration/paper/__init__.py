"""The paper's own procedure (Urquhart et al. 2016, section 4), kept as reference and for the studies.

`dlt` the linear pose · `constraints` c1, c2, c3 · `stages` the three-stage fit.
"""
