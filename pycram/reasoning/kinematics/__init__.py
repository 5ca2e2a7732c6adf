"""Forward and inverse kinematics, computed from the URDF without the engine."""
