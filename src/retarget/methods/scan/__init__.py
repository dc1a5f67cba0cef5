"""Captures without correspondence: a cloud of points a frame becomes the motion of an embedded human (after Rekik 2023)."""
