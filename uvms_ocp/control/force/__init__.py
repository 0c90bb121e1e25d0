"""Reference velocities in, thrust and torque out."""
