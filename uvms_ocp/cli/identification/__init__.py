"""In: what is to be learnt, and recordings. Out: commands that show it, what is doubtful, and a calibrated robot."""
