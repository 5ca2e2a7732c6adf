"""The verbs of ``pycram-replay``, one a module: ``add`` says what it takes, ``run`` does it and returns the exit code."""
