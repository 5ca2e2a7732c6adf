"""Folders of recordings as tables: statistics, facts that separate failures from successes, exports of many runs."""
