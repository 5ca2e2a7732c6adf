"""The verbs of ``pycram-replay``.

``add(parser)`` declares the arguments of a verb, in addition to the recording and ``--json``. ``run(log, options)``
prints the result, and returns an exit code, or None for success.
"""
