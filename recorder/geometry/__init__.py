"""Poses, URDF kinematics, shapes and polygons: arithmetic that all three packages use, and that knows none of them."""

from recorder.geometry.transforms import (
    IDENTITY as IDENTITY,
    Pose as Pose,
    PoseLike as PoseLike,
    Quaternion as Quaternion,
    Vector as Vector,
    angle as angle,
    conjugate as conjugate,
    from_matrix as from_matrix,
    from_rpy as from_rpy,
    invert as invert,
    lean as lean,
    look_at as look_at,
    multiply as multiply,
    pose_matrix as pose_matrix,
    product as product,
    rotate as rotate,
    to_matrices as to_matrices,
    to_matrix as to_matrix,
    to_rpy as to_rpy,
    transform as transform,
)
