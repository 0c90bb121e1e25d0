"""In: recordings, and a vehicle with unknowns. Out: the unknowns that explain the recordings best."""
