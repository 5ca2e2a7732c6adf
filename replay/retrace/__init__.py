"""Runs a plan again, guided by its recording: either to compare all records, or to continue live after a step."""
