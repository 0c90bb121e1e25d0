"""In: a calibration. Out: what was measured beside what it predicts, what is left, and how sure its numbers are."""
