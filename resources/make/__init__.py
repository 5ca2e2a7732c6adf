"""Makers of the meshes and URDFs in the folder above; all of them are computed from numbers."""
