"""Cooperative scheduling: branches of a plan are greenlets of a thread, and one branch runs until its next checkpoint.

A checkpoint is a wait, the start of a motion, or a change of a world that isn't part of a motion. At a checkpoint, the
run's seed decides which branch runs next.

- Code that holds a lock (:class:`pycram.scheduling.schedule.Lock`) must not wait or yield; LockHeld is raised.
- User code (event handlers, functions of fluents, resolvers, plans) is called without locks, because it may yield.
- A change comes first and its notification afterwards. Waits check their predicates again after each notification.
"""
