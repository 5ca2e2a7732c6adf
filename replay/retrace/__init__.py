"""Runs a plan again, guided by its recording: to compare the records, or to leave the recording at a step."""
