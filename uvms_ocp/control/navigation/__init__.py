"""Readings of sensors in, one measurement with its age out."""
