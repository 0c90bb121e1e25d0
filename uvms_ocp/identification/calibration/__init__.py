"""In: a file that says what of a robot is to be learnt, and recordings. Out: its numbers, how good they are, and its new file."""
