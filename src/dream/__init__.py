"""DREAM: an underwater robot that finds and maps a habitat without knowing where it is."""

__version__ = "0.1.0"
