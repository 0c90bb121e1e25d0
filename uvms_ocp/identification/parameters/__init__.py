"""In: numbers of a vehicle and what may be learnt of them. Out: coordinates, at every value of which they are physical."""
