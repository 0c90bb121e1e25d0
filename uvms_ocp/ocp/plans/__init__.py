"""A trajectory with its verdict in; a record, a file and back, and how far a plant departed from it out."""
