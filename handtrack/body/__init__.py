"""Skeletons, depth images, rooms and inertial suits in, body poses with their uncertainty out."""
