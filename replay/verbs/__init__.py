"""The verbs of ``pycram-replay``, one a module: ``add`` says what it takes, ``run`` gives facts and text."""
