"""Health of the sensors: screened readings and the trust in every channel out.

`GuardedEstimator` puts a `HealthMonitor` around any estimator: the monitor screens the readings
before it, takes the outcomes of its gates after it, and the estimate carries the verdicts.
"""
