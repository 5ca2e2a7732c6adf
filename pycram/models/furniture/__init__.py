"""Furniture: where things can stand, and what opens, found in a model's shapes and joints."""
