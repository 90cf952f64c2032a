"""What a dive leaves beside its steps: `config.json` and `summary.json`."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dream import __version__
from dream.commands.dive.options import mounting_told, repeating_command
from dream.commands.outcome import home_told
from dream.ending import ENDED, why
from dream.planning import PLANNERS
from dream.planning.identity import identity
from dream.versions import commit

if TYPE_CHECKING:
    from dream.commands.dive.ready import Ready
    from dream.commands.dive.tank import Tank
    from dream.evaluation.metrics import Logbook
    from dream.homeward import Budget
    from dream.perception import Account
    from dream.robots.bluerov2.bridge import Bridge
    from dream.robots.bluerov2.rov import BlueRov2


def config(ready: Ready, name: str, budget: Budget | None) -> dict[str, Any]:
    """`config.json`: what the dive was begun with, and what its mission may spend."""
    told = asdict(replace(ready.told, planner=PLANNERS["belief"]))
    # What is known of the ground is kept beside; the address of an archive may hold a password.
    del told["planner"], told["ground"], told["homing"]
    mounting = mounting_told(ready.told)
    return {
        "version": __version__,
        "commit": commit(),
        "protocol": ready.protocol.name,
        "bounds": asdict(ready.limits.area),
        "world": "dive" if ready.tank is None else ready.tank.world.name,
        "seed": ready.told.seed,
        **identity(name, ready.told.planner),
        "max_steps": ready.told.max_steps,
        "budget": None if budget is None else budget.as_dict(),
        "command": repeating_command(ready.told, name),
        "began": datetime.datetime.fromtimestamp(ready.devices.log.epoch_ns / 1e9, datetime.UTC),
        "mounting": {
            "dvl": np.asarray(mounting.T_base_dvl.translation).tolist(),
            "gauge": list(mounting.pressure_sensor),
            "camera": np.asarray(ready.mount.translation).tolist(),
        },
        **ready.known.config(),
        "dive": {key: str(value) if isinstance(value, Path) else value for key, value in told.items()},
    }


def summary(
    ready: Ready,
    name: str,
    logbook: Logbook,
    bridge: Bridge,
    robot: BlueRov2,
    wall_s: float,
    stopped: BaseException | None,
) -> dict[str, Any]:
    """`summary.json`: of the mission, what stopped it, and of the devices."""
    from dream.sim.files import world_hash

    flown = logbook.summary()

    devices = ready.devices
    lags = [1e3 * lag for lag in bridge.lags] or [0.0]
    ages = [1e3 * age for age in robot.picture_ages] or [0.0]
    counts, seconds = devices.camera.counts, devices.now()
    tank = ready.tank
    return {
        "protocol": ready.protocol.name,
        "world": "dive" if tank is None else tank.world.name,
        "seed": ready.told.seed,
        "world_hash": "" if tank is None else world_hash(tank.world),
        "planner": name,
        **flown,
        "why": why("" if flown["ended"] == "aborted" else flown["ended"], stopped),
        # Nobody feels a touch but a simulator.
        **({"collisions": None} if tank is None else {}),
        "wall_s": round(wall_s, 3),
        "dive": {
            "estimator": ready.told.estimator,
            "drive": ready.told.drive,
            "command_lag_ms": {f"p{p}": round(float(np.percentile(lags, p)), 1) for p in (50, 99)},
            "late_beats": bridge.late_beats,
            "picture_age_ms": {f"p{p}": round(float(np.percentile(ages, p)), 1) for p in (50, 99)},
            "perception": _perception(robot.accounts),
            "pictures": counts.received,
            "pictures_per_s": round(counts.received / seconds, 2),
            "packets_lost": counts.lost,
            "link_loss": round(devices.link.telemetry.loss, 4),
            "refused": {**devices.link.refused, **devices.dvl.refused, **devices.navigator.refused},
            "pilot_refused": None if devices.station is None else dict(devices.station.refused),
            "log_lost": devices.log.lost,
            "behind_s": None if tank is None else _behind(tank),
        },
    }


def _perception(accounts: Sequence[Account]) -> dict[str, Any]:
    """How far the frames of a mission could be believed."""
    return {
        "frames": len(accounts),
        "confidence": round(float(np.mean([one.confidence for one in accounts])), 3) if accounts else None,
        "frames_doubted": sum(bool(one.doubt) for one in accounts),
        "frames_checked": sum(one.points > 0 for one in accounts),
        "frames_scaled": sum(math.isfinite(one.scale) for one in accounts),
        "frames_without_depth": sum(one.confidence == 0.0 for one in accounts),
        "pixels_without_label": sum(one.lost for one in accounts),
        "pixels_without_depth": sum(one.no_depth for one in accounts),
    }


def _behind(tank: Tank) -> float | None:
    """Seconds by which the stand-in is late; None where it is gone."""
    try:
        return round(tank.running.truth().behind, 3)
    except OSError:
        return None


def print_outcome(summary: Mapping[str, Any], page: Path | None) -> None:
    """The summary in a few lines."""
    ended = ENDED[summary["ended"]]
    print(f"{summary['world']} {summary['seed']} · {summary['planner']} · {summary['protocol']}")
    print(f"  {ended} after {summary['steps']} steps and {summary['distance_m']:.1f} m")
    if summary["home"] is not None:
        print(f"  {home_told(summary['home'])}")
    if summary["ended"] == "aborted":
        print(f"  why: {summary['why']}")
    if summary["coverage"]["instances"] is not None:
        error = summary["position_error_m"]
        print(
            f"  traversed {summary['coverage']['instances']:.1%} of the individuals, {summary['collisions']} "
            f"contacts; {error['rmse']:.3f} m (rms) from where it believed to be"
        )
    dive = summary["dive"]
    print(
        f"  {dive['pictures_per_s']:.1f} pictures a second; from goal to command "
        f"{dive['command_lag_ms']['p50']:.0f} ms, at most {dive['command_lag_ms']['p99']:.0f} ms in 99 of 100"
    )
    if page is not None:
        print(f"  report: {page}")
