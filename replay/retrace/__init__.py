"""Runs a plan again beside its recording, and finds the first record that comes out differently."""
