"""Makers of the meshes and URDFs in the folder above: each is computed from numbers, none is drawn by hand."""
