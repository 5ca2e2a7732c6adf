"""Recording inside of a running program: the journal, spans of tasks, call stacks, and the deferral of Ctrl-C."""
