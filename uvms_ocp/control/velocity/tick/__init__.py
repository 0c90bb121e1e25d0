"""A tick of the kinematic layer but for the hierarchy, as kernels: a measurement in, a velocity and where the mission is out."""
