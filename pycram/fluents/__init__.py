"""Fluents: values that branches of a plan share, wait for and react to, and values that follow a world."""
