"""First descriptions of robots, guessed from their URDFs, and checks of descriptions: ``pycram describe``."""
