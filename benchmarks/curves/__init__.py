"""In: way points, scenes. Out: rows of errors and times of the trajectories found for them."""
