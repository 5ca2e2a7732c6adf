"""Recordings as MCAP files that survive the death of the process that writes them."""
