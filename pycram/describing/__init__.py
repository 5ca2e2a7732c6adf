"""``pycram describe``: guess a description of a robot from its URDF, check a description, or describe furniture."""
