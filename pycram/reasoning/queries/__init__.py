"""The reasoning queries (thesis 4.4, table 4.3): each leaves no trace in the world, and its answer is recorded."""
