"""What happened: the tasks, failures and changes of a recording, who made them, and the lines of the plan."""
