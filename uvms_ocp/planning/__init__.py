"""Ahead of time: optimal control with strict priorities."""
