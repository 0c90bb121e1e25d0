"""Force layer: reference velocities in, thrust and torque out."""
