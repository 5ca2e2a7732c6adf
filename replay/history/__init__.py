"""The history of a run: tasks, failures, changes and their originators, and the lines of the plan."""
