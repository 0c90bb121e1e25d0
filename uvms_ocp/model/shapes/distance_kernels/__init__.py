"""Signed distances of spheres, capsules, cylinders and boxes in machine code; coal is their oracle.

`distance_memory` says what a program of one's own embeds and calls.
"""
