"""A run folder → a survey: what its frames say of a reef or a wreck, each figure with its interval."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from dream import __version__
from dream.mapping import Layers as MapLayers
from dream.mapping import OccupancyMap
from dream.mapping.hull import Hull
from dream.mapping.volume import Volume
from dream.perception.scatter import scatter_of
from dream.recording import VOLUME, RecordedStep, RunConfig, digest_of_steps, read_config, read_steps
from dream.survey.calibration import calibration_for
from dream.survey.ground import Frame, Ground, fuse
from dream.survey.intervals import around
from dream.survey.reef import measure_reef
from dream.survey.site import Site
from dream.survey.standing import Looks, measure_structures, of_what_stands
from dream.survey.survey import (
    DAYS_A_YEAR,
    DecisionPoint,
    Layers,
    Measure,
    Picture,
    Survey,
    SurveyedStructure,
    Track,
)
from dream.survey.wreck import measure_wreck, no_individuals
from dream.types import Observation, Reasoning, Target
from dream.versions import commit

UNKNOWN, EXPLORED, TARGET, SOLID, SOLID_TARGET = range(5)
"""Values of `Layers.state`."""
HULL_SHARE = 0.15
"""Share of the target cells that are solid in a wreck, at least, where nobody said what was looked for."""

AROUND_TARGET = 1.0
"""Metres around target that the picture of the ground shows."""

GUESSED = "when its config.json was written"
"""Of `made_by["began_by"]`: that of a copy may have been written at any time."""

Told = Callable[[int, int], None]
"""Is told how many of how many frames are taken in."""


@dataclass(frozen=True, slots=True)
class About:
    """What a survey says of its mission beside what was seen."""

    name: str
    began: datetime
    site: Site | None = None
    target: Target = Target.ANY
    decisions: tuple[DecisionPoint, ...] = ()
    sigma: tuple[float, ...] = ()
    """Metres by which the position may err at each observation; none where it is the truth."""
    made_by: dict[str, Any] = field(default_factory=dict)


def measure(run: Path, site: Site | None = None, *, told: Told | None = None) -> Survey:
    """The survey of a run whose observations were kept.

    Args:
        run: Its folder, of the simulator or of a dive.
        site: Where on earth it was; what the folder's `site.json` says where None.
        told: Is told of the progress.

    Raises:
        FileNotFoundError: It is no run, or its observations were not kept; the message says how to fly again.
        ValueError: Some of it is damaged.
    """
    config, steps = read_config(run), read_steps(run)
    kept = _Kept(run)
    occupancy = _map_of(run)
    volume = volume_of(run) if occupancy.protocol.space is not None else None
    if site is None and (run / "site.json").is_file():
        from dream.survey.site import read_site

        site = read_site(run / "site.json")
    return measure_observations(
        kept, occupancy, _about(run, config, steps, len(kept), site), volume=volume, told=told
    )


def measure_observations(
    observations: Collection[Observation],
    occupancy: MapLayers,
    about: About,
    *,
    volume: Volume | None = None,
    told: Told | None = None,
) -> Survey:
    """The survey of a mission from what it saw.

    Args:
        observations: All of them, in order. They are gone through up to twice.
        occupancy: The map that they made.
        about: The mission.
        volume: The map in three dimensions of a mission that moved in them.
        told: Is told of the progress.

    Raises:
        ValueError: There are no observations.
    """
    if not len(observations):
        raise ValueError("survey: expected at least one observation, got none")
    frames, track = _taken_in(observations, about, told)
    protocol, scatter = occupancy.protocol, scatter_of(frames)
    # What counts is how far poses err against each other, not against the globe.
    sigma = float(np.median(track.sigma)) if len(track.sigma) else 0.0
    target = _kind(occupancy) if about.target is Target.ANY else about.target
    looks = None
    if target is Target.WRECK and volume is not None:
        looks = Looks(volume, scatter)
        told_apart = [looks.integrate(frame) for frame in frames]
        if protocol.lasting is not None:  # Its labels are wrong at the same places from everywhere.
            frames = told_apart
    ground = fuse(frames, occupancy.bounds, protocol, scatter)
    parts: tuple[SurveyedStructure, ...] = ()
    if target is Target.WRECK:
        hull = _hull_seen(observations, occupancy) if looks is None else None
        measures, found, above = measure_wreck(ground, frames, protocol, hull, sigma)
        if looks is not None:
            inspected, parts = measure_structures(looks, ground, sigma)
            measures = (*(measures if protocol.lasting is None else of_what_stands(measures)), *inspected)
        individuals = no_individuals()
    else:
        reef = measure_reef(ground, frames, occupancy, sigma)
        measures, found, above, individuals = reef.measures, reef.patches, reef.height, reef.individuals
    parameters = {"cell": ground.cell, "scatter": ground.scatter}
    # As a file gives it back, where a tuple is a list: else one that was read seems measured by another.
    calibration = json.loads(json.dumps(asdict(calibration_for(ground.scatter))))
    return Survey(
        name=about.name,
        began=about.began,
        site=about.site,
        target=target,
        protocol=occupancy.protocol.name,
        area=occupancy.bounds,
        measures=(*measures, _seen_share(occupancy)),
        individuals=individuals,
        patches=found,
        layers=_layers(occupancy, ground, above, by_labels=looks is None or protocol.lasting is None),
        track=track,
        decisions=about.decisions,
        made_by={**about.made_by, "measuring": {**parameters, "calibration": calibration}},
        picture=_picture(ground),
        structures=parts,
    )


class _Kept(Collection[Observation]):
    """The observations in a run folder, read one by one."""

    def __init__(self, run: Path) -> None:
        from dream.robots import replay

        self._files = sorted((run / replay.FOLDER).glob("*.npz"))
        if not self._files:
            raise FileNotFoundError(
                f"{run}: expected a run with its observations, got no {replay.FOLDER}/*.npz in it. "
                "Fly it again with --keep-observations, or with --site"
            )
        for number, file in enumerate(self._files):
            if file.name != f"{number:04d}.npz":
                raise ValueError(f"{file}: expected {number:04d}.npz before it, which is missing")

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[Observation]:
        from dream.robots import replay

        return (replay.read(file).observation for file in self._files)

    def __contains__(self, item: object) -> bool:
        return any(item is seen for seen in self)


def _taken_in(
    observations: Collection[Observation], about: About, told: Told | None
) -> tuple[list[Frame], Track]:
    frames, times, places, yaws = [], [], [], []
    for number, seen in enumerate(observations, start=1):
        frames.append(Frame.of(seen))
        times.append(seen.time)
        places.append(seen.T_world_base.translation)
        yaws.append(seen.T_world_base.yaw)
        if told is not None:
            told(number, len(observations))
    sigma = np.zeros(len(frames))
    given = np.asarray(about.sigma[: len(frames)], np.float64)
    sigma[: len(given)] = given
    track = Track(
        np.array(times, np.float64), np.array(places, np.float64), np.array(yaws, np.float64), sigma
    )
    return frames, track


def _hull_seen(observations: Collection[Observation], occupancy: MapLayers) -> Hull:
    hull = Hull(occupancy.bounds, occupancy.protocol)
    for seen in observations:
        hull.integrate(seen)
    return hull


def _kind(occupancy: MapLayers) -> Target:
    """What was found: a hull stands in the way, shells lie on the ground."""
    target = occupancy.target
    solid, every = int(np.count_nonzero(target & occupancy.solid)), int(np.count_nonzero(target))
    return Target.WRECK if solid > HULL_SHARE * max(every, 1) else Target.OYSTERS


def _seen_share(occupancy: MapLayers) -> Measure:
    """Of the area that was to be seen; a cell at its border may count or not."""
    wanted = occupancy.to_see
    seen = occupancy.known & wanted
    share = int(np.count_nonzero(seen)) / max(int(np.count_nonzero(wanted)), 1)
    rim = int(np.count_nonzero(seen[1:] != seen[:-1]) + np.count_nonzero(seen[:, 1:] != seen[:, :-1]))
    told = around("seen_share", share, 0.25 * rim / max(wanted.size, 1), "")
    assert told.high is not None
    return Measure("seen_share", share, told.low, min(told.high, 1.0), "", "of the area that was to be seen")


def _layers(
    occupancy: MapLayers, ground: Ground, above: np.ndarray[Any, np.dtype[np.float64]], *, by_labels: bool
) -> Layers:
    """Maps on the map's grid; target is what the map says by labels, or what the fine picture shows of it."""
    seen, solid, target = occupancy.known, occupancy.solid, occupancy.target
    if not by_labels:
        (rows, cols), times = occupancy.shape, round(occupancy.protocol.cell / ground.cell)
        fine = (ground.share > 0.5).reshape(rows, times, cols, times)
        target = np.asarray(fine.any(axis=(1, 3)), np.bool_)
    state = np.full(occupancy.shape, UNKNOWN, np.uint8)
    state[seen] = EXPLORED
    state[target & seen] = TARGET
    state[solid] = SOLID
    state[solid & target] = SOLID_TARGET
    probability = np.where(seen, occupancy.target_probability, np.nan).astype(np.float32)
    return Layers(
        bounds=occupancy.bounds,
        cell=occupancy.protocol.cell,
        state=state,
        target_probability=probability,
        relief=np.where(seen, above, np.nan).astype(np.float32),
        times_seen=ground.times,
    )


def _picture(ground: Ground) -> Picture:
    """Of the ground around target, which is all that a comparison looks at."""
    near = ground.around_target(AROUND_TARGET)
    share = np.where(near.seen, np.rint(200.0 * near.share), 255.0).astype(np.uint8)
    return Picture(near.bounds, near.cell, share)


def _map_of(run: Path) -> OccupancyMap:
    path = run / "map.npz"
    if not path.is_file():
        raise FileNotFoundError(f"{run}: expected a run with its map, got no map.npz in it. Fly it again")
    return OccupancyMap.load(path)


def volume_of(run: Path) -> Volume:
    """The map of a run that moved in three dimensions.

    Raises:
        FileNotFoundError: It is not there.
        ValueError: It is damaged.
    """
    path = run / VOLUME
    if not path.is_file():
        raise FileNotFoundError(f"{run}: expected a run with its volume, got no {VOLUME} in it. Fly it again")
    return Volume.load(path)


def _about(
    run: Path, config: RunConfig, steps: Sequence[RecordedStep], observed: int, site: Site | None
) -> About:
    sigma = {step.step: step.position_sigma_m for step in steps}
    began, by = _began(run, config)
    # The clock of the machine did not wait for a simulated year.
    years = 0.0 if config.real else config.years_on
    began += timedelta(days=DAYS_A_YEAR * years)
    return About(
        name=run.resolve().name,
        began=began,
        site=site,
        target=_target(config),
        decisions=tuple(_decision(step) for step in steps if step.step > 0),
        sigma=tuple(sigma.get(number, 0.0) for number in range(observed)),
        made_by={
            "version": __version__,
            "commit": commit(),
            "planner": config.planner,
            **({} if config.real else {"world": config.world, "seed": config.seed}),
            **({"years_on": years} if years else {}),
            "began_by": by,
            "run": digest_of_steps(run),
            "flown_by": {"version": config.version, "commit": config.commit},
        },
    )


def _began(run: Path, config: RunConfig) -> tuple[datetime, str]:
    """When it began, and by what that is known.

    An older run does not say. Its folder's name does, in UTC, and without seconds where a still older version
    gave it; where it is called otherwise, there is only when its config was written.
    """
    from dream.robots.bluerov2.log import dive_began

    if (recorded := config.began or dive_began(run)) is not None:
        return recorded.astimezone(UTC).replace(microsecond=0), "its own record"
    found = re.match(r"(\d{4}-\d\d-\d\dT\d\d-\d\d)(-\d\d)?_", run.resolve().name)
    if found:
        minute, second = found.groups(default="-00")
        try:
            began = datetime.strptime(minute + second, "%Y-%m-%dT%H-%M-%S").replace(tzinfo=UTC)
            return began, "the name of its folder"
        except ValueError:
            pass  # Such as month 13: not ours.
    written = (run / "config.json").stat().st_mtime
    return datetime.fromtimestamp(written, UTC).replace(microsecond=0), GUESSED


def _target(config: RunConfig) -> Target:
    """What the orders look for; anything where they do not say one thing."""
    legs = (config.orders or {}).get("legs")
    named = {leg.get("target") for leg in legs if isinstance(leg, dict)} if isinstance(legs, list) else set()
    only = named.pop() if len(named) == 1 else None
    return Target(only) if only in set(Target) else Target.ANY


def _decision(step: RecordedStep) -> DecisionPoint:
    said = step.reasoning
    return DecisionPoint(
        step=step.step,
        time=step.time,
        x=step.pose.x,
        y=step.pose.y,
        yaw=step.pose.yaw,
        turn=step.guarded.turn,
        advance=step.guarded.advance,
        reasoning=Reasoning(
            said.distribution, said.target_area, said.completion, said.next_target, said.safety, said.action
        ),
        note="; ".join(filter(None, (step.guarded.note, step.arrival_note, step.open_region))),
    )
