"""Series as tables. In: arrays by name with their metadata. Out: what each column is, and files that others read."""
