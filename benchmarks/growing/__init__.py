"""Works whose cost grows with a size, each made ready by one function."""
