"""Multiple shooting: an optimal control problem becomes a sparse lexicographic program."""
