"""Missions → Network: a teacher, what it says of many frames, and a student that learns it."""
