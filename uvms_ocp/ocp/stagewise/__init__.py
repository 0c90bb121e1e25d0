"""Optimal control stage by stage: nothing but the dynamics couples the steps of a horizon."""
