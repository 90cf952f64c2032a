"""The picture of a dive: what it is made of, by the signs and units that it says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.cli import run_command
from dream.evaluation.dive_figure import BODY_ABOVE_DVL, draw_dive, read_dive
from dream.geometry import SE3
from dream.measurements import Depth, Dvl
from dream.recording import record, write_config
from dream.robots.bluerov2.log import DiveLog
from dream.types import Step
from tests.recorded_runs import CONFIG, painted_mission

SAYS = dialect.MAVLink(None)


def sent(message: Any) -> Any:
    message.pack(SAYS)
    return message


def fix(yaw: float, ahead: float, left: float, turn: float, x: float = 1.0) -> SimpleNamespace:
    pose = SE3.level(x, 2.0, -0.9, yaw)
    velocity = pose.rotation @ np.array([ahead, left, 0.0])
    return SimpleNamespace(
        T_world_base=pose, velocity=velocity, angular_velocity=np.array([0.0, 0.0, turn]), position_sigma=0.01
    )


def logged(folder: Path, *, standing: tuple[tuple[float, str], ...] = ()) -> Path:
    """Five seconds of a dive that swims ahead and to the left while it turns left."""
    with DiveLog(folder, epoch_ns=10**18) as log:
        log.tap(0.0, "goal", True, {"x": 1.5, "y": 2.5, "yaw": 0.5, "altitude": 0.6})
        for beat in range(50):
            time = 0.1 * beat
            log.tap(time, "estimate", False, fix(0.3, 0.2, 0.1, 0.4, x=1.0 + 0.02 * beat))
            log.tap(
                time,
                "mavlink",
                True,
                sent(dialect.MAVLink_manual_control_message(1, 500, -250, 500, -100, 0)),
            )
            log.tap(time, "measurement", False, Depth(time, -0.9, 0.01))
            covariance = 1e-4 * np.eye(3)
            log.tap(time, "measurement", False, Dvl(time, np.zeros(3), covariance, 0.5, True))
        for time, stance in standing:
            log.tap(time, "standing", True, {"stance": stance, "reason": "a reason"})
    return folder


def test_it_shows_forward_left_and_up_whatever_the_wire_says(tmp_path: Path) -> None:
    flown = read_dive(logged(tmp_path))
    np.testing.assert_allclose(flown.estimate[0], [0.0, 1.0, 2.0, -0.9, 0.3, 0.2, 0.1, 0.4], atol=1e-9)
    np.testing.assert_allclose(flown.goals, [[0.0, 1.5, 2.5, 0.5, 0.6]])
    np.testing.assert_allclose(flown.sticks[7], [0.7, 0.5, 0.25, 0.1], atol=1e-9)
    np.testing.assert_allclose(flown.depth[:, 1], 0.9)
    np.testing.assert_allclose(flown.altitude[:, 1], 0.5 + BODY_ABOVE_DVL)
    assert flown.occupancy is None
    assert len(flown.velocities) == len(flown.truth) == 0


def test_it_knows_when_no_motion_was_asked_for(tmp_path: Path) -> None:
    stances = ((1.0, "slow"), (2.0, "neutral"), (3.0, "yield"), (4.0, "go"), (4.5, "over"))
    flown = read_dive(logged(tmp_path, standing=stances))
    np.testing.assert_allclose(flown.stopped, [(2.0, 4.0), (4.5, 4.9)])


@pytest.mark.rare
def test_velocities_of_guided_are_shown_where_they_drove(tmp_path: Path) -> None:
    with DiveLog(tmp_path, epoch_ns=10**18) as log:
        log.tap(0.0, "estimate", False, fix(0.0, 0.0, 0.0, 0.0))
        target = dialect.MAVLink_set_position_target_local_ned_message
        message = target(0, 1, 1, 8, 0x5C7, 0, 0, 0, 0.2, -0.1, 0, 0, 0, 0, 0, -0.3)
        log.tap(0.5, "mavlink", True, sent(message))
        log.tap(1.0, "estimate", False, fix(0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(read_dive(tmp_path).velocities, [[0.5, 0.2, 0.1, 0.3]], atol=1e-7)
    draw_dive(tmp_path)


def known(step: Step) -> Step:
    return replace(step, arrival=replace(step.arrival, truth=SE3.level(0.5, 0.25, -0.9, 1.0)))


def test_truth_and_map_are_those_of_the_steps(tmp_path: Path) -> None:
    logged(tmp_path)
    write_config(tmp_path, CONFIG)
    for _ in record(map(known, painted_mission(3)), tmp_path):
        pass
    flown = read_dive(tmp_path)
    np.testing.assert_allclose(flown.truth[:, 1:], [[0.5, 0.25, 1.0]] * 3)
    assert flown.occupancy is not None
    assert flown.occupancy.seen.any()


@pytest.mark.rare
def test_the_same_dive_gives_the_same_picture(tmp_path: Path) -> None:
    logged(tmp_path, standing=((2.0, "neutral"),))
    svg, png = draw_dive(tmp_path)
    first = svg.read_bytes(), png.read_bytes()
    draw_dive(tmp_path)
    assert (svg.read_bytes(), png.read_bytes()) == first
    assert b"<svg" in first[0]
    with Image.open(png) as picture:
        assert picture.width > 1000


@pytest.mark.rare
def test_a_heading_that_wraps_is_drawn_without_a_jump(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[np.ndarray] = []
    from matplotlib.axes import Axes

    plot = Axes.plot

    def keep(axes: Axes, *lines: Any, **look: Any) -> Any:
        drawn.extend(np.asarray(line, float) for line in lines if not isinstance(line, str))
        return plot(axes, *lines, **look)

    monkeypatch.setattr(Axes, "plot", keep)
    with DiveLog(tmp_path, epoch_ns=10**18) as log:
        log.tap(0.0, "goal", True, {"x": 1.0, "y": 2.0, "yaw": -3.0, "altitude": 0.6})
        for beat in range(80):
            log.tap(0.1 * beat, "estimate", False, fix(math.remainder(0.1 * beat, math.tau), 0.0, 0.0, 1.0))
    draw_dive(tmp_path)
    turned = np.degrees(0.1 * np.arange(80))
    assert any(line.shape == (80,) and np.allclose(line, turned, atol=1e-6) for line in drawn)


def test_a_folder_without_a_dive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        draw_dive(tmp_path)
    with DiveLog(tmp_path, epoch_ns=10**18) as log:
        log.tap(0.0, "goal", True, {"x": 0.0, "y": 0.0, "yaw": 0.0, "altitude": 0.6})
    with pytest.raises(ValueError, match="expected estimates of the pose, got none"):
        draw_dive(tmp_path)


@pytest.mark.rare
def test_the_report_of_a_dive_is_written_with_its_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logged(tmp_path)
    write_config(tmp_path, {**CONFIG, "command": "dream dive belief --stand-in"})
    for _ in record(painted_mission(2), tmp_path):
        pass
    assert run_command(["report", str(tmp_path)]) == 0
    assert (tmp_path / "dive.svg").is_file()
    assert f"{tmp_path}/report.html" in capsys.readouterr().out
    assert "dream dive belief --stand-in" in (tmp_path / "report.html").read_text()


def test_a_report_is_written_also_where_the_log_is_none(tmp_path: Path) -> None:
    write_config(tmp_path, CONFIG)
    for _ in record(painted_mission(2), tmp_path):
        pass
    (tmp_path / "log.mcap").write_bytes(b"something else")
    assert run_command(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").is_file()
    assert not (tmp_path / "dive.svg").exists()
