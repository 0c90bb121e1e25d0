"""In: a vehicle, and limits of its thrust and of the pool. Out: commands from which recordings determine its numbers."""
