"""A stand-in as a process of its own: `python -m dream.robots.bluerov2.standin --help`."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
from collections.abc import Callable
from typing import Any

from dream.geometry import Camera
from dream.protocol import protocol_named
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.parameters import NEXT, STABLE
from dream.robots.bluerov2.standin.tank import Conditions
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.robots.bluerov2.standin.video import Faults, VideoSource, eye
from dream.robots.bluerov2.standin.wire import LinkFaults
from dream.sim.render import Renderer
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Current, Spread
from dream.sim.worlds import make_world


def main(arguments: list[str] | None = None) -> None:
    """Run until stdin closes; the first line on stdout is where its sockets are."""
    parser = argparse.ArgumentParser(prog="standin", description=__doc__)
    parser.add_argument("--world", default="pool/arc")
    parser.add_argument("--seed", type=int, default=1, help="of the world and of the dive")
    parser.add_argument("--gcs", default="127.0.0.1:14550", help="HOST:PORT of the ground station")
    parser.add_argument("--host", default="127.0.0.1", help="where its sockets are bound")
    parser.add_argument(
        "--a50-port", type=int, default=0, help="0 for any free one; the instrument's is 16171"
    )
    parser.add_argument("--video", help="HOST:PORT that pictures are sent to; none without")
    parser.add_argument("--width", type=int, default=320, help="pixels of a picture, 4:3")
    parser.add_argument("--fps", type=float, default=10.0, help="pictures a second")
    parser.add_argument("--vehicle", choices=("heavy", "standard"), default="heavy")
    parser.add_argument("--vary", action="store_true", help="draw drag, trim and buoyancy")
    parser.add_argument("--current", type=float, nargs=2, default=(0.0, 0.0), metavar=("EAST", "NORTH"))
    parser.add_argument("--gust", type=float, default=0.0, help="m/s by which the current varies")
    parser.add_argument("--system", type=int, default=1, help="MAVLink id of the vehicle")
    parser.add_argument("--firmware", choices=("stable", "next"), default="stable")
    parser.add_argument(
        "--position", action="store_true", help="the autopilot knows where it is, as GUIDED needs"
    )
    parser.add_argument("--depth", type=float, help="metres where it starts; the protocol's altitude without")
    parser.add_argument("--declination", type=float, default=0.0, help="degrees of the compass, to the east")
    parser.add_argument(
        "--origin", type=float, nargs=3, metavar=("LAT", "LON", "ALT"), help="that it takes when it is armed"
    )
    parser.add_argument("--loss", type=float, default=0.0, help="share of MAVLink datagrams that are lost")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds that they take")
    parser.add_argument("--jitter", type=float, default=0.0, help="seconds on top, at most")
    told = parser.parse_args(arguments)
    host, port = _address(parser, "--gcs", told.gcs)
    video = None if told.video is None else _address(parser, "--video", told.video)
    world = make_world(told.world, told.seed)
    conditions = Conditions(
        vehicle=BLUEROV2_HEAVY if told.vehicle == "heavy" else BLUEROV2,
        spread=Spread() if told.vary else None,
        current=Current(mean=(*told.current, 0.0), gust=told.gust),
        declination=math.radians(told.declination),
    )
    standin = StandIn(
        world,
        seed=told.seed,
        ground=(host, port),
        host=told.host,
        a50_port=told.a50_port,
        conditions=conditions,
        depth=told.depth,
        system=told.system,
        firmware=STABLE if told.firmware == "stable" else NEXT,
    )
    standin.ardusub.fix = told.position
    for name, value in zip(("LAT", "LON", "ALT"), told.origin or (), strict=False):
        standin.ardusub.parameters.change(f"ORIGIN_{name}", value)
    standin.wire.faults = LinkFaults(told.loss, told.delay, told.jitter)
    with contextlib.ExitStack() as stack:
        stack.enter_context(standin)
        source = None
        if video is not None:
            field = protocol_named(world.protocol).camera.horizontal_fov
            camera = Camera.from_fov(told.width, told.width * 3 // 4, field)
            draw = eye(Renderer(world), camera, lambda: standin.T_world_base @ standin.T_base_camera)
            source = stack.enter_context(VideoSource(draw, video, fps=told.fps, seed=told.seed))
        standin.start()
        where = {"ardusub": standin.ardusub_address, "a50": standin.a50_address, "surface_hpa": AIR_PRESSURE}
        _say(where)
        for line in sys.stdin:
            try:
                _say(_answer(json.loads(line), standin, source))
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                _say({"error": f"{type(error).__name__}: {error}"})


def _say(told: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


def _address(parser: argparse.ArgumentParser, option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        parser.error(f"{option}: expected HOST:PORT, got {text}")
    return host, int(port)


def _answer(question: dict[str, Any], standin: StandIn, source: VideoSource | None) -> dict[str, Any]:
    """What a line of input asks for: `{"ask": "truth"}`, or `{"ask": "fault", "of": ..., ...}`."""
    if question["ask"] == "truth":
        with standin.lock:
            pose = standin.T_world_base
            return {
                "time": standin.tank.time,
                "rotation": pose.rotation.ravel().tolist(),
                "position": pose.translation.tolist(),
                "collisions": standin.tank.collisions,
                "behind": standin.behind,
                "problem": standin.problem,
            }
    if question["ask"] == "fault":
        with standin.lock:
            _fault({name: value for name, value in question.items() if name != "ask"}, standin, source)
        return {}
    raise ValueError(f"ask: expected truth or fault, got {question['ask']!r}")


def _fault(fault: dict[str, Any], standin: StandIn, source: VideoSource | None) -> None:
    """Set what is wrong with one part: the fields of its own faults, or one of its methods by name."""
    part = fault.pop("of")
    if part == "link":
        standin.wire.faults = LinkFaults(**fault)
    elif part == "video":
        if source is None:
            raise ValueError("video: expected a stand-in that sends one, got none. Add --video")
        source.faults = Faults(**fault)
    elif part == "a50":
        standin.a50.faults = type(standin.a50.faults)(**fault)
    elif part in ("tank", "ardusub"):
        name = fault.pop("do")
        if name not in _DONE[part]:
            raise ValueError(f"{part}: expected one of {', '.join(_DONE[part])}, got {name!r}")
        method: Callable[..., object] = getattr(getattr(standin, part), name)
        method(**fault)
    else:
        raise ValueError(f"of: expected link, video, a50, tank or ardusub, got {part!r}")


_DONE = {"tank": ("drain", "leave", "pull"), "ardusub": ("reboot", "jump_clock", "set_mode", "disarm")}


if __name__ == "__main__":
    main()
