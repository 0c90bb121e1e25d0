"""A measurement and a mission in, reference velocities out."""
