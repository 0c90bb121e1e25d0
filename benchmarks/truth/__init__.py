"""Drawn problems of optimal control, and judges of plans that know nothing of the planner."""
