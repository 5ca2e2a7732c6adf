"""Forward and inverse kinematics: arithmetic on the URDF."""
