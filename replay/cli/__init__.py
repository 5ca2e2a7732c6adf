"""The verbs of ``pycram-replay``.

``add(parser)`` declares the arguments of a verb, in addition to the recording and ``--json``. ``run(log, options)``
prints the result, and returns the exit code: 0, or 1 after a failed check.
"""
