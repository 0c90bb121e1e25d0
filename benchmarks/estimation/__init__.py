"""The estimator against truths: drawn from its own process model, and of missions."""
