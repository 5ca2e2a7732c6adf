"""From bytes to records: the index, chunks, and what can be recovered of a damaged file."""
