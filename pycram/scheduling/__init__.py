"""Scheduling: which branch of a plan runs, where branches give way to each other, and how they are told to stop.

The branches of a plan's concurrent blocks are greenlets: stacks of their own within the thread that opened the block.
One of them runs at a time, and goes on until it gives way, which it does at a checkpoint only:

- before a motion, and before a change of a world that isn't part of a motion;
- in a wait for what doesn't hold yet: for a fluent, a part of the robot, a result, the end of a block.

So the same plan takes the same order each time, and between two checkpoints no other branch changes anything. Threads
of the plan's own, the clock of a world in real time and workers of ``in_thread`` run beside that, in no order.

Rules:

- Who holds a lock (:class:`pycram.scheduling.locks.Lock`, which those of worlds and fluents are) must not give way:
  the lock is the thread's, so the next branch of the same thread would get in too. It is refused with ``LockHeld``.
  Other locks are held for a few assignments, without user code, waits or changes of a world.
- User code (handlers of events, functions of networks, resolvers, plans) is never called with a lock held, as it may
  give way. Who is called by user code is prepared for another state of the world afterwards.
- What blocks the thread outside of PyCRAM (``time.sleep``, a socket, ``threading`` locks and events) blocks all its
  branches: :func:`pycram.scheduling.worker.in_thread` runs it in a worker while its branch waits.
- Who changes what others wait for does so first and notifies then, from any thread; waits look again, so notifying
  once too often harms nobody.
- Ctrl-C reaches the code that opened the outermost block of the main thread, at its next checkpoint, and it alone: it
  cancels the branches (:mod:`recorder.tracing.interrupts`).
"""
