"""What each command of `dream` does. Its fields are its options; calling it runs it."""

from dream.commands.bench import Bench
from dream.commands.dive import Dive
from dream.commands.export import Export
from dream.commands.fly import Fly
from dream.commands.mission import Mission
from dream.commands.oracle import Oracle
from dream.commands.plan import MissionPlan as Plan
from dream.commands.probe import Probe
from dream.commands.replay import Replay
from dream.commands.report import Report
from dream.commands.results import Results
from dream.commands.run import Run, run_with
from dream.commands.seal import Seal
from dream.commands.survey import Survey
from dream.commands.sweep import Sweep
from dream.commands.teach import Teach
from dream.commands.train import Train
from dream.commands.watch import Watch
from dream.commands.worlds import Draw, Worlds

__all__ = [
    "Bench",
    "Dive",
    "Draw",
    "Export",
    "Fly",
    "Mission",
    "Oracle",
    "Plan",
    "Probe",
    "Replay",
    "Report",
    "Results",
    "Run",
    "Seal",
    "Survey",
    "Sweep",
    "Teach",
    "Train",
    "Watch",
    "Worlds",
    "run_with",
]
