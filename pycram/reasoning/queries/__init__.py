"""The reasoning queries (thesis 4.4, table 4.3): each leaves no trace, and its answer goes on record."""
