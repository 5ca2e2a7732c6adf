"""The reasoning queries (thesis 4.4, table 4.3), which don't change the world, and whose answers are recorded."""
