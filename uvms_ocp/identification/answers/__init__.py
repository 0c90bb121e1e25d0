"""In: an estimate. Out: what it predicts, how sure it is, and what the recordings do not determine."""
