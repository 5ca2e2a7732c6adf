"""Explanations of failures, as frozen data and as text."""
