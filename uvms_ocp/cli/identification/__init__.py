"""A robot's own numbers, from the command line. In: what is to be learnt. Out: commands that show it, and what recordings say."""
