"""The command ``pycram describe``: guess a robot's description from its URDF, check it, or describe furniture."""
