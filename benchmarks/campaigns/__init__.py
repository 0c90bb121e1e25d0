"""In: a kind of work. Out: campaigns of it that are killed, counted and timed."""
