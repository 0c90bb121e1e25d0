"""Fault detection and isolation of thrusters and joints, and the control authority that is left."""
