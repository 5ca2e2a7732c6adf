"""The history of a run: tasks, failures, changes and what caused them, and the lines of the plan."""
