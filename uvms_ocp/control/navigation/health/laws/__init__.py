"""Kernels of what can be said against a reading: each knows its own layout, and none of the channels' states."""
