"""Distances as rows of optimal control problems, and proof of them between the nodes."""
