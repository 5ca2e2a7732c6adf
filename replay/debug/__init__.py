"""Debugs a recorded plan: it runs again, guided by its recording, stops at a step, and goes on from there or back.

The process with the prompt reads the recording, which answers most: what there is at a step, and to which step a
command leads. The plan's process is there for what no recording has: frames, variables, expressions. A copy of it (a
fork) waits at some steps on the way, so that going back is to wake the nearest copy before.
"""
