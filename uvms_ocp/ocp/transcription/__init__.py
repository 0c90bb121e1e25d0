"""An optimal control problem in, a sparse lexicographic program out."""
