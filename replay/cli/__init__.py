"""The verbs of ``pycram-replay``, in files by their idea.

``add(parser)`` declares its arguments beside the recording and ``--json``; ``run(log, options)`` prints its results
and returns the exit code: 0, or 1 if what it checks is not so. :mod:`replay.cli.main` finds the verb.
"""
