"""One run of a campaign. In: its number. Out: a row."""
