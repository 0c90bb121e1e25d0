"""QPs beside one that a first run has not solved: what comes of them tells why, or solves it."""
