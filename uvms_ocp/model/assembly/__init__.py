"""Robots in, other robots out: an arm mounted on a vehicle, one taken off, floats and ballast for trim."""
