"""Velocity layer: a state estimate and a mission in, reference velocities out."""
