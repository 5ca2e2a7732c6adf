"""What a running program records: the journal, spans of tasks, call stacks; and how Ctrl-C is deferred meanwhile."""
