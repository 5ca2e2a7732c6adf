"""The reasoning queries (thesis 4.4, table 4.3): they don't change the world, and their answers are recorded."""
