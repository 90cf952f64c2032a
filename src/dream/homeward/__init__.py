"""The way home: what a mission may spend, what the way back takes of it, and when it has to turn round."""

from dream.homeward.budget import Budget, read_budget
from dream.homeward.keeper import Homeward

__all__ = ["Budget", "Homeward", "read_budget"]
