"""Runs a plan again, guided by its recording: all records are compared, or the plan continues live after a step."""
