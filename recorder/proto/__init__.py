"""The definition of the log and the modules compiled from it."""
