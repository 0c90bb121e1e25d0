"""In: a robot of this package. Out: vehicles like it with drawn numbers, and recordings of them as
sensors would make them.
"""
