"""Paths in, checked text out: URDF, hydrodynamics.yaml and where robots are kept."""
