"""Runs → numbers that a reviewer believes."""
