"""A dive in one picture: where it went, what it was sent to and by which sticks, how fast and how deep."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.evaluation.figures import Picture, Theme
from dream.files import write_whole
from dream.mapping import OccupancyMap
from dream.mapping.drawing import SOLID_TARGET, TARGET, TRAVERSED
from dream.recording import read_steps
from dream.robots.bluerov2.log import NAME, doubting, read_log
from dream.robots.bluerov2.navigation import Instruments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

logger = logging.getLogger(__name__)

KINDS = ("svg", "png")
MOST_POINTS = 3000
"""Points of a line; of longer ones every n-th is drawn."""
STOPPED = ("neutral", "yield", "over")
"""Stances in which DREAM asks for no motion."""
BODY_ABOVE_DVL = -float(Instruments().mounting.T_base_dvl.translation[2])
"""Metres: the DVL hears the floor from where it sits."""
BELIEVED, TRUE, AHEAD, LEFT, TURN, STILL = 5, 1, 0, 2, 4, 3
"""Which of a theme's colours is whose."""
PALER = 0.35
"""How far cells of targets are drawn towards the ground below the ways."""
_TOPICS = ("/estimate", "/goal", "/standing", "/depth", "/dvl/altitude", "/mavlink/sent")


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """What a picture of a dive shows. Seconds on the dive's clock, metres, radians; forward, left, up."""

    estimate: Array
    """(N, 8) time, x, y, z, yaw; then m/s ahead and to the left, rad/s of turn."""
    goals: Array
    """(G, 5) time, x, y, yaw, altitude."""
    sticks: Array
    """(S, 4) time; then shares of the full stick ahead, to the left and of turn, in −1 to 1."""
    velocities: Array
    """(V, 4) time; then what GUIDED was asked for, m/s ahead and to the left, rad/s of turn."""
    depth: Array
    """(D, 2) time, metres."""
    altitude: Array
    """(A, 2) time, metres from the seabed to the body, as the DVL heard it."""
    stopped: tuple[tuple[float, float], ...]
    """From when to when DREAM asked for no motion."""
    truth: Array
    """(K, 4) time, x, y, yaw at the ends of steps; K = 0 where nobody knows."""
    occupancy: OccupancyMap | None
    """The final map; None where the dive was killed before it was saved."""


def draw_dive(folder: Path) -> list[Path]:
    """Draw `dive.svg` and `dive.png` in the folder of a dive, from what lies in that folder alone.

    Raises:
        FileNotFoundError: There is no log in it.
        ValueError: The log is none of a dive, or tells nothing of where the vehicle was; or what reads it is
            not installed.
        OSError: The folder cannot be written.
    """
    picture = Picture("dive", "A dive", "", _Drawing(read_dive(folder)).draw)
    paths = [folder / f"dive.{kind}" for kind in KINDS]
    for path, drawn in zip(paths, (picture.svg(), picture.png(dpi=130)), strict=True):
        write_whole(path, drawn)
    return paths


def read_dive(folder: Path) -> Flown:
    """What the picture shows, from the log, the steps and the map of a run. Raises as `draw_dive` does."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    told: dict[str, list[tuple[float, ...]]] = {name: [] for name in _TOPICS}
    velocities: list[tuple[float, ...]] = []
    stances: list[tuple[float, str]] = []
    for logged in read_log(folder / NAME, _TOPICS):
        with doubting(logged):
            message, rows = logged.message, told[logged.topic]
            if logged.topic == "/estimate":
                rows.append((logged.time, *_estimate(message)))
            elif logged.topic == "/goal":
                said = json.loads(message.data)["said"]
                # One that is held at a height has no altitude.
                altitude = said.get("altitude", math.nan)
                rows.append((logged.time, *map(float, (said["x"], said["y"], said["yaw"], altitude))))
            elif logged.topic == "/standing":
                stances.append((logged.time, str(json.loads(message.data)["said"]["stance"])))
            elif logged.topic == "/mavlink/sent":
                for sent in parser.parse_buffer(message.data.tobytes()) or ():
                    if sent.get_type() == "MANUAL_CONTROL":
                        rows.append((logged.time, sent.x / 1000.0, -sent.y / 1000.0, -sent.r / 1000.0))
                    elif sent.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                        velocities.append((logged.time, sent.vx, -sent.vy, -sent.yaw_rate))
            else:
                rows.append((logged.time, _metres(message)))
    estimate = _rows(told["/estimate"], 8)
    if len(estimate) == 0:
        raise ValueError(f"{folder / NAME}: expected estimates of the pose, got none. Did the dive begin?")
    over = float(estimate[-1, 0])
    steps = read_steps(folder) if (folder / "steps.jsonl").is_file() else []
    known = [(step.time, *_at(step.truth)) for step in steps if step.truth is not None]
    return Flown(
        estimate=estimate,
        goals=_rows(told["/goal"], 5),
        sticks=_rows(told["/mavlink/sent"], 4),
        velocities=_rows(velocities, 4),
        depth=_rows(told["/depth"], 2),
        altitude=_rows(told["/dvl/altitude"], 2),
        stopped=tuple(_spans(stances, over)),
        truth=_rows(known, 4),
        occupancy=_map(folder / "map.npz"),
    )


def _estimate(message: Any) -> tuple[float, ...]:
    place, turned = message.pose.pose.position, message.pose.pose.orientation
    yaw = math.atan2(
        2.0 * (turned.w * turned.z + turned.x * turned.y), 1.0 - 2.0 * (turned.y**2 + turned.z**2)
    )
    moves = message.twist.twist
    return (place.x, place.y, place.z, yaw, moves.linear.x, moves.linear.y, moves.angular.z)


def _metres(message: Any) -> float:
    """From the surface by a report of depth; from the seabed to the body by one of the DVL's altitude."""
    if hasattr(message, "pose"):
        return -float(message.pose.pose.position.z)
    return float(message.range) + BODY_ABOVE_DVL


def _at(pose: Any) -> tuple[float, float, float]:
    return (pose.x, pose.y, pose.yaw)


def _rows(told: Sequence[tuple[float, ...]], width: int) -> Array:
    return np.array(told, np.float64).reshape(-1, width)


def _spans(stances: list[tuple[float, str]], over: float) -> list[tuple[float, float]]:
    """From when to when no motion was asked for; what lasts to the end of the dive ends with it."""
    ends = [*(time for time, _ in stances[1:]), math.inf]
    spans = [
        (time, min(end, over))
        for (time, stance), end in zip(stances, ends, strict=False)
        if stance in STOPPED and time < over
    ]
    joined: list[tuple[float, float]] = []
    for begin, end in spans:
        if joined and begin <= joined[-1][1]:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((begin, end))
    return joined


def _map(path: Path) -> OccupancyMap | None:
    if not path.is_file():
        logger.warning("%s is not there, and left out of the picture", path)
        return None
    return OccupancyMap.load(path)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    flown: Flown

    def draw(self, theme: Theme) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.6, 9.6), layout="constrained", facecolor=theme.ground)
        axes = figure.subplot_mosaic(
            [
                ["map", "x"],
                ["map", "y"],
                ["map", "heading"],
                ["sticks", "speed"],
                ["turning", "turn"],
                ["depth", "altitude"],
            ],
        )
        self._draw_map(axes["map"], theme)
        self._draw_poses([axes[name] for name in ("x", "y", "heading")], theme)
        self._draw_commands([axes[name] for name in ("sticks", "turning")], theme)
        self._draw_motion([axes[name] for name in ("speed", "turn")], theme)
        self._draw_heights(axes["depth"], axes["altitude"], theme)
        began, over = (float(self.flown.estimate[end, 0]) for end in (0, -1))
        for name, each in axes.items():
            if name == "map":
                continue
            each.set_xlim(began, max(over, began + 1.0))
            for begin, end in self.flown.stopped:
                each.axvspan(begin, end, color=theme.tracks[STILL], alpha=0.15, linewidth=0)
            each.tick_params(labelbottom=name in ("depth", "altitude"))
        for name in ("depth", "altitude"):
            axes[name].set_xlabel("s of the dive")
        self._key(figure, axes["map"], theme)
        return figure

    def _draw_map(self, axes: Axes, theme: Theme) -> None:
        flown = self.flown
        if flown.occupancy is not None:
            bounds = flown.occupancy.bounds
            extent = (bounds.x_min, bounds.x_max, bounds.y_min, bounds.y_max)
            axes.imshow(_painted(flown.occupancy, theme), origin="lower", extent=extent, interpolation="none")
        if len(flown.goals):
            axes.plot(*flown.goals[:, 1:3].T, "+", color=theme.soft, markersize=6, markeredgewidth=1.0)
        axes.plot(*_thin(flown.estimate)[:, 1:3].T, color=theme.tracks[BELIEVED], linewidth=1.4)
        axes.plot(*flown.estimate[0, 1:3], "o", color=theme.ink, markersize=5)
        if len(flown.truth):
            axes.plot(*flown.truth[:, 1:3].T, "o", color=theme.tracks[TRUE], markersize=3)
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.set_title("From above")
        axes.set(xlabel="x, m", ylabel="y, m")

    def _draw_poses(self, axes: list[Axes], theme: Theme) -> None:
        from matplotlib.ticker import MultipleLocator

        flown = self.flown
        estimate = flown.estimate.copy()
        estimate[:, 4] = np.unwrap(estimate[:, 4])
        over = float(estimate[-1, 0])

        def beside(rows: Array, column: int) -> Array:
            """Headings on the turn that the estimate is on by then."""
            believed = np.interp(rows[:, 0], estimate[:, 0], estimate[:, 4])
            return np.asarray(believed + np.mod(rows[:, column] - believed + np.pi, 2.0 * np.pi) - np.pi)

        lines = (
            ("x, m", flown.goals[:, 1], estimate[:, 1], flown.truth[:, 1]),
            ("y, m", flown.goals[:, 2], estimate[:, 2], flown.truth[:, 2]),
            (
                "Heading, °",
                np.degrees(beside(flown.goals, 3)),
                np.degrees(estimate[:, 4]),
                np.degrees(beside(flown.truth, 3)),
            ),
        )
        for each, (title, goals, believed, truth) in zip(axes, lines, strict=True):
            _draw_goals(each, flown.goals[:, 0], goals, over, theme)
            each.plot(
                *_thin(np.column_stack([estimate[:, 0], believed])).T,
                color=theme.tracks[BELIEVED],
                linewidth=1.3,
            )
            each.plot(flown.truth[:, 0], truth, "o", color=theme.tracks[TRUE], markersize=3)
            each.set_title(title)
        axes[2].yaxis.set_major_locator(MultipleLocator(_quarters(estimate[:, 4])))

    def _draw_commands(self, axes: list[Axes], theme: Theme) -> None:
        """Sticks; or velocities, where the vehicle was driven by those."""
        flown = self.flown
        level, turning = axes
        guided = bool(np.any(flown.velocities[:, 1:]))
        rows = _thin(_within(flown.velocities if guided else flown.sticks, flown.estimate))
        turn = np.degrees(rows[:, 3]) if guided else 100.0 * rows[:, 3]
        for column, name, color in ((1, "ahead", AHEAD), (2, "to the left", LEFT)):
            factor = 1.0 if guided else 100.0
            level.plot(
                rows[:, 0], factor * rows[:, column], color=theme.tracks[color], linewidth=0.9, label=name
            )
        turning.plot(rows[:, 0], turn, color=theme.tracks[TURN], linewidth=0.9)
        level.set_title("Velocity sent, m/s" if guided else "Sticks sent, % of full")
        turning.set_title("Turn sent, °/s" if guided else "Turn stick sent, % of full")
        _name_lines(level)

    def _draw_motion(self, axes: list[Axes], theme: Theme) -> None:
        rows = _thin(self.flown.estimate)
        speed, turn = axes
        for column, name, color in ((5, "ahead", AHEAD), (6, "to the left", LEFT)):
            speed.plot(
                rows[:, 0], 100.0 * rows[:, column], color=theme.tracks[color], linewidth=0.9, label=name
            )
        turn.plot(rows[:, 0], np.degrees(rows[:, 7]), color=theme.tracks[TURN], linewidth=0.9)
        speed.set_title("Velocity believed, cm/s")
        turn.set_title("Turn rate, °/s")
        _name_lines(speed)

    def _draw_heights(self, depth: Axes, altitude: Axes, theme: Theme) -> None:
        flown = self.flown
        over = float(flown.estimate[-1, 0])
        depth.plot(*_thin(_within(flown.depth, flown.estimate)).T, color=theme.tracks[AHEAD], linewidth=1.1)
        depth.invert_yaxis()
        depth.set_title("Depth, m")
        _draw_goals(altitude, flown.goals[:, 0], flown.goals[:, 4], over, theme)
        altitude.plot(
            *_thin(_within(flown.altitude, flown.estimate)).T, color=theme.tracks[AHEAD], linewidth=1.1
        )
        altitude.set_title("Altitude, m")
        for each in (depth, altitude):
            _at_least(each, 0.1)

    def _key(self, figure: Figure, over: Axes, theme: Theme) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        flown = self.flown
        handles: list[Line2D | Patch] = [
            Line2D([], [], color=theme.soft, linewidth=1.1, linestyle=(0, (3, 2)), label="sent to"),
            Line2D([], [], color=theme.tracks[BELIEVED], label="believed to be"),
        ]
        if len(flown.truth):
            handles.append(
                Line2D([], [], color=theme.tracks[TRUE], marker="o", markersize=3, linestyle="", label="is")
            )
        if flown.stopped:
            handles.append(Patch(color=theme.tracks[STILL], alpha=0.15, label="not steered"))
        if flown.occupancy is not None:
            kinds = [("explored", theme.grid), ("target", _hex(_pale(TARGET, theme)))]
            if flown.occupancy.protocol.traversal is not None:
                kinds.append(("traversed", _hex(_pale(TRAVERSED, theme))))
            handles += [Patch(color=color, label=name) for name, color in (*kinds, ("solid", theme.ink))]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), handlelength=1.6)


def _painted(occupancy: OccupancyMap, theme: Theme) -> npt.NDArray[np.uint8]:
    """(rows, columns, 3) colours of the cells, south first."""
    colors = np.full((*occupancy.shape, 3), _rgb(theme.ground), np.uint8)
    colors[occupancy.seen] = _rgb(theme.grid)
    colors[occupancy.target] = _pale(TARGET, theme)
    colors[occupancy.target & occupancy.traversed] = _pale(TRAVERSED, theme)
    colors[occupancy.solid] = _rgb(theme.ink)
    colors[occupancy.solid & occupancy.target] = SOLID_TARGET
    return colors


def _name_lines(axes: Axes) -> None:
    """Above the panel, beside its title."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0, handlelength=1.4)


def _draw_goals(axes: Axes, times: Array, values: Array, over: float, theme: Theme) -> None:
    if len(times):
        axes.step(
            [*times, over],
            [*values, values[-1]],
            where="post",
            color=theme.soft,
            linewidth=1.1,
            linestyle=(0, (3, 2)),
        )


def _quarters(yaw: Array) -> float:
    """Degrees between two marks of the heading: whole quarter turns, some four of them."""
    return 90.0 * max(1, round(float(np.degrees(np.ptp(yaw))) / 360.0))


def _within(rows: Array, estimate: Array) -> Array:
    """What was while there was an estimate."""
    return np.asarray(rows[(rows[:, 0] >= estimate[0, 0]) & (rows[:, 0] <= estimate[-1, 0])])


def _thin(rows: Array) -> Array:
    return rows[:: max(1, math.ceil(len(rows) / MOST_POINTS))]


def _at_least(axes: Axes, span: float) -> None:
    """Keep noise of millimetres from filling the panel."""
    low, high = sorted(axes.get_ylim())
    lacking = max(span - (high - low), 0.0) / 2.0
    inverted = axes.yaxis_inverted()
    axes.set_ylim(low - lacking, high + lacking)
    if inverted:
        axes.invert_yaxis()


def _pale(color: tuple[int, int, int], theme: Theme) -> tuple[int, int, int]:
    mixed = [round((1.0 - PALER) * c + PALER * g) for c, g in zip(color, _rgb(theme.ground), strict=True)]
    return mixed[0], mixed[1], mixed[2]


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _hex(color: tuple[int, int, int]) -> str:
    return f"#{color[0]:02x}{color[1]:02x}{color[2]:02x}"
