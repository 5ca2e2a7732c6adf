"""Folders of recordings as tables: statistics, what separates failures from successes, and exports of many runs."""
