"""Series as MCAP files, which Foxglove opens. In: arrays by name with their metadata. Out: a file, and the same again."""
