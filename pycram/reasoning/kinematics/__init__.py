"""Where links are for joint values, and the other way round: arithmetic on the URDF."""
