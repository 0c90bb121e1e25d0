"""Robot files in, the machine out: where it is, how it moves, what the water does to it."""
