"""The history of a run: tasks, failures, changes and their causes, and the lines of the plan."""
