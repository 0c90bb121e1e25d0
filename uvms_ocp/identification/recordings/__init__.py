"""In: files of any kind. Out: a recording as a value, what is doubtful about it, and its channels at any times."""
