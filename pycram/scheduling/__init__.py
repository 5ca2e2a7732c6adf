"""Cooperative scheduling of a plan's branches, and their cancellation.

The branches of concurrent blocks are greenlets of the thread that opened the block. One of them runs at a time, until a
checkpoint:

- before a motion, and before a change of a world that isn't part of a motion;
- in a wait for what doesn't hold yet: for a fluent, a part of the robot, a result, the end of a block.

Who is next is drawn from the run's seed: the same plan runs in the same order each time with the same seed. No other
branch changes anything between two checkpoints.
Threads of the plan's own, the clock of a world in real time and the workers of ``in_thread`` run in parallel, in no
fixed order.

Rules:

- Code that holds a lock (:class:`pycram.scheduling.locks.Lock`, used by worlds and fluents) must not yield: the lock
  belongs to the thread, so the thread's next branch would get in too. ``LockHeld`` refuses it. Other locks are held for
  a few assignments, without user code, waits or changes of a world.
- User code (event handlers, functions of fluents, resolvers, plans) is called without locks, as it may yield; the world
  may be another one afterwards.
- What blocks the thread outside of PyCRAM (``time.sleep``, a socket, ``threading`` locks and events) blocks all its
  branches: :func:`pycram.scheduling.worker.in_thread` runs it in a worker while its branch waits.
- A change that others wait for is made first and notified then, from any thread. Waits check their predicate again, so
  spurious notifications are harmless.
- Ctrl-C is raised in the code that opened the main thread's outermost block, at its next checkpoint, and nowhere else;
  that block cancels its branches (:mod:`recorder.tracing.interrupts`).
"""
