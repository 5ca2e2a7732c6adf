"""Cooperative scheduling: branches of a plan are greenlets of a thread, and one branch runs until its next checkpoint.

A checkpoint is a wait, the start of a motion, or a change of a world that isn't part of a motion. At a checkpoint, the
run's seed decides which branch runs next. A change comes first and its notification afterwards. Waits check their
predicates again after each notification.
"""
