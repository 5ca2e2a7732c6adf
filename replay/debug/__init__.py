"""Debug a recorded plan: the plan runs again, guided by its recording, stops at a step, and continues or goes back.

The process of the prompt reads states, and the steps to which commands lead, from the recording. Only the plan's
process has frames, variables and values of expressions; recordings don't contain these. Copies (forks) of the plan's
process wait at some of its steps. To go back, the debugger continues the nearest copy that waits before the target.
"""
