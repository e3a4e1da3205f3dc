"""Articulated finger tracking."""
