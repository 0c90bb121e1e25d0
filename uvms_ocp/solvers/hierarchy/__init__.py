"""Levels of linear rows in strict order in, the velocity that is lexicographically best out."""
