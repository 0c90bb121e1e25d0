"""Readings in, those that may be used and what is thought of every channel out.

`GuardedEstimator` puts a `HealthMonitor` around any estimator: before it the monitor vets the readings, after it it hears what
became of them, and the measurement carries the verdicts.
"""
