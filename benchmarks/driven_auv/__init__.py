"""In: recordings of an AUV driven by its thrusters. Out: how well an identified vehicle predicts
those it has not seen.
"""
