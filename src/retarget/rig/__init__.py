"""A bare mesh gets bones: a rigged template is fitted to it, and hands on its skeleton, weights and rest pose."""
