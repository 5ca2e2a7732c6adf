"""Cooperative scheduling of a plan's branches, and their cancellation.

The branches of concurrent blocks are greenlets of the thread that opened the block. One branch runs at a time, until a
checkpoint:

- before a motion, and before a change of a world that isn't part of a motion;
- whenever it waits for a condition: a fluent, a part of the robot, a result, the end of a block.

The next branch is drawn from the run's seed: with the same seed, the same plan runs in the same order. No other branch
changes anything between two checkpoints. Threads that the plan starts, the clock of a world in real time and the
workers of ``in_thread`` run in parallel, in no fixed order.

Rules:

- Code that holds a lock (:class:`pycram.scheduling.schedule.Lock`, used by worlds and fluents) must not yield: the lock
  belongs to the thread, so the next branch would hold it too. ``LockHeld`` is raised then. Other locks are held for a
  few assignments only, without user code, waits or changes of a world.
- User code (event handlers, functions of fluents, resolvers, plans) is called without locks, as it may yield and change
  the world.
- A call that blocks the thread outside of PyCRAM (``time.sleep``, a socket, ``threading`` locks and events) blocks all
  branches of the thread: :func:`pycram.scheduling.worker.in_thread` runs it in a worker while its branch waits.
- A change that others wait for is made first and notified afterwards, from any thread. Waits check their predicates
  again, so spurious notifications are harmless.
- Ctrl-C is raised only in the code that opened the main thread's outermost block, at its next checkpoint; that block
  cancels its branches (:mod:`recorder.tracing.interrupts`).
"""
