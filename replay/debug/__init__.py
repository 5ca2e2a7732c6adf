"""Debugs a recorded plan: the plan runs again, guided by its recording. It stops at a step, and continues or goes back.

The prompt's process reads states and the targets of commands from the recording. The plan's process provides data that
no recording has: frames, variables, expressions. Copies of it (forks) wait at some steps. To go back, the debugger
wakes the nearest copy before the target.
"""
