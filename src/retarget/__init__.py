"""Any motion onto any body."""

__version__ = "0.1.0"
