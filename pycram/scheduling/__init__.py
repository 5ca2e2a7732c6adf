"""Cooperative scheduling: branches of a plan are greenlets of a thread, and one branch runs until its next checkpoint.

A checkpoint is a wait, the start of a motion, or a change of a world outside of a motion. At a checkpoint, the run's
seed decides which branch runs next.

- Code that holds a lock (:class:`pycram.scheduling.schedule.Lock`) must not wait or yield; LockHeld is raised.
- User code (event handlers, functions of fluents, resolvers, plans) is called without locks, because it may yield.
- A call that blocks the thread outside of PyCRAM, such as ``time.sleep``, blocks all branches of the thread;
  :func:`pycram.scheduling.worker.in_thread` runs such a call in a worker.
- A change comes first and its notification afterwards. Waits check their predicates again after each notification.
- Ctrl-C is raised only in the code that opened the outermost block of the main thread, at its next checkpoint. That
  block cancels its branches (:mod:`recorder.tracing.interrupts`).
"""
