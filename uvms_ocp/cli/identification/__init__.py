"""In: recordings, and what is to be learnt from them. Out: what is doubtful about them, and a calibrated robot."""
