"""What each command of `dream` does. Its fields are its options; calling it runs it."""

from dream.commands.bench import Bench
from dream.commands.report import Report
from dream.commands.run import Run, planner_name
from dream.commands.worlds import Draw, Worlds

__all__ = ["Bench", "Draw", "Report", "Run", "Worlds", "planner_name"]
