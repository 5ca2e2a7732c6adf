"""Debug a recorded plan: the plan runs again, guided by its recording, stops at a step, and continues or goes back.

The process of the prompt reads states and the targets of commands from the recording. The plan's process has frames,
variables and values of expressions, which recordings lack. Copies (forks) of the plan's process wait at some steps. To
go back, the debugger wakes the nearest copy before the target.
"""
