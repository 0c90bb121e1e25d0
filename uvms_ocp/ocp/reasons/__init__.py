"""A plan that fails or misses in; what holds it back, and what would have to change, out."""
