"""Health of the sensors: screened readings and the trust in every channel out.

`GuardedEstimator` puts a `HealthMonitor` around any estimator: before it the monitor screens the readings, after it it is informed
of what became of them, and the estimate carries the verdicts.
"""
