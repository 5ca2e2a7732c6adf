"""Edited plans that are tried as whole runs: smaller plans with the same failure, and repairs."""
