"""Readings of late and noisy sensors in, one state and its covariance out: an error-state Kalman filter in C or NumPy."""
