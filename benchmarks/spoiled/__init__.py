"""Recordings of drawn vehicles, what may go wrong with one, and every doubt about it."""
