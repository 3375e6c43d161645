"""Collision geometry against the mesh that it stands for."""
