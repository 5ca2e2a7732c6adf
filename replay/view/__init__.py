"""Recordings in the Rerun viewer."""
