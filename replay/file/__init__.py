"""From bytes to records: the index, the chunks, and the recovery of damaged files."""
