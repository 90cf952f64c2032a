"""A stand-in as a process of its own: `python -m dream.robots.bluerov2.standin --help`."""

from __future__ import annotations

import argparse
import json
import sys

from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.parameters import NEXT, STABLE
from dream.robots.bluerov2.standin.tank import Conditions
from dream.robots.bluerov2.standin.wire import LinkFaults
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
    parser.add_argument("--vehicle", choices=("heavy", "standard"), default="heavy")
    parser.add_argument("--vary", action="store_true", help="draw drag, trim and buoyancy")
    parser.add_argument("--current", type=float, nargs=2, default=(0.0, 0.0), metavar=("EAST", "NORTH"))
    parser.add_argument("--gust", type=float, default=0.0, help="m/s by which the current varies")
    parser.add_argument("--system", type=int, default=1, help="MAVLink id of the vehicle")
    parser.add_argument("--firmware", choices=("stable", "next"), default="stable")
    parser.add_argument("--loss", type=float, default=0.0, help="share of MAVLink datagrams that are lost")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds that they take")
    parser.add_argument("--jitter", type=float, default=0.0, help="seconds on top, at most")
    told = parser.parse_args(arguments)
    host, _, port = told.gcs.rpartition(":")
    if not host or not port.isdigit():
        parser.error(f"--gcs: expected HOST:PORT, got {told.gcs}")
    conditions = Conditions(
        vehicle=BLUEROV2_HEAVY if told.vehicle == "heavy" else BLUEROV2,
        spread=Spread() if told.vary else None,
        current=Current(mean=(*told.current, 0.0), gust=told.gust),
    )
    standin = StandIn(
        make_world(told.world, told.seed),
        seed=told.seed,
        ground=(host, int(port)),
        host=told.host,
        a50_port=told.a50_port,
        conditions=conditions,
        system=told.system,
        firmware=STABLE if told.firmware == "stable" else NEXT,
    )
    standin.wire.faults = LinkFaults(told.loss, told.delay, told.jitter)
    with standin:
        standin.start()
        where = {"ardusub": list(standin.ardusub_address), "a50": list(standin.a50_address)}
        sys.stdout.write(json.dumps(where) + "\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
