"""What a running program publishes: the journal of records, spans of tasks, call sites, and how Ctrl-C is deferred."""
