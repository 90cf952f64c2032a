"""The list that is gone through before a dive: of the devices, and of what only this dive asks for."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dream.commands.console import print_json
from dream.geometry import SE3
from dream.perception import View
from dream.types import Label

if TYPE_CHECKING:
    from dream.commands.dive.ready import Ready
    from dream.perception import Account
    from dream.robots.bluerov2.check import Finding

STILL = 4.0
"""Seconds that the sensors are listened to before the dive, with the vehicle lying still."""
FIRST_REPORT = 5.0
"""Seconds that the connection to the DVL may take."""
FIRST_FRAME = 15.0
"""Seconds that the first frame of the camera may take."""
LOOKS = 10
"""Pictures that are looked at to see whether the computer keeps its time."""
MISSED = 0.05
"""Share of the beats that may come late by a whole beat then."""
LEASE_SPENT = 0.3
"""Seconds by which none may: a command lives for 0.4."""
LABELLED = 0.5
"""Share of the seconds that looking may take in a dive which depth and labels of a picture may take."""
LEAST_SURE = 0.1
"""Mean confidence in a picture's labels and depth below which a dive is none."""
FLOATING = 0.5
"""Share of what is above the horizon that is told where it is labelled seabed."""
MOST_LOST = 0.1
"""Share of the view that may have no label."""


def predive_list(ready: Ready) -> list[Finding]:
    """The pre-dive list; the camera is pointed before, since its pictures are part of it."""
    link = ready.devices.link
    pointed, sounded = _pointed(ready), _sounded(ready)
    now, threads = ready.devices.now, ready.devices.threads
    began = now()
    while not ready.devices.camera.connected and now() - began < FIRST_FRAME:
        link.operator_alive()
        threads.sleep(0.1)
    found = ready.devices.findings(STILL, ready.start, ready.limits, ready.folder)
    return [pointed, *sounded, *found, _floor(ready), _looked(ready), _in_time(ready)]


def _floor(ready: Ready) -> Finding:
    """Whether the dive may go as deep as it has to."""
    from dream.robots.bluerov2.check import Finding
    from dream.robots.bluerov2.home import SHALLOW
    from dream.robots.bluerov2.navigation import NotReady

    altitude, deepest = ready.protocol.altitude, ready.limits.depth
    # Nearer to the surface than that the way home takes it for surfaced, and disarms it.
    wanted = f"{SHALLOW:g} to {deepest:g} m: a deeper floor, or another --max-depth"
    seabed, problem, began = math.nan, "", ready.devices.now()
    try:
        while math.isnan(seabed) and ready.devices.now() - began < FIRST_REPORT:
            fix = ready.devices.navigator.update()
            seabed, problem = fix.seabed, fix.altitude_problem
            ready.devices.threads.sleep(0.05)
    except NotReady:
        return Finding("floor", ok=False, said="not known before navigation begins", wanted=wanted)
    if math.isnan(seabed):
        return Finding("floor", ok=False, said=problem or "the DVL does not see it", wanted=wanted)
    deep = -ready.protocol.launch_height(seabed)
    where = f"{deep:.1f} m deep" if deep > 0.0 else "out of the water"
    said = f"{altitude:g} m above it is {where}, {deepest:g} m are allowed"
    return Finding("floor", ok=SHALLOW <= deep <= deepest, said=said, wanted=wanted)


def _looked(ready: Ready) -> Finding:
    """Make of one picture what the map is made from: lens and models fit it, or the dive is none."""
    from dream.robots.bluerov2.check import Finding

    wanted = (
        "a picture that --calibration, --labels and --depth fit: with the camera over a flat floor, depths "
        "that agree with the vehicle's height above it. Is the model's sidecar right about its unit? With "
        '"output": "relative_depth" the floor gives the scale'
    )
    if ready.sight.lens is None and ready.tank is None:
        return Finding("pictures", ok=False, said="no --calibration was given", wanted=wanted)
    try:
        eye, perception = ready.eye, ready.sight.perception.anew
        picture = ready.devices.camera.newest(FIRST_FRAME)
        began, camera = time.perf_counter(), ready.protocol.camera
        try:
            rgb, seen = eye.view(picture, camera)
        except ValueError as error:
            fitting = "a lens file of the pictures that come: see --calibration"
            if ready.tank is not None:
                fitting = "no --calibration: the camera of the stand-in has no lens to correct"
            return Finding("pictures", ok=False, said=str(error), wanted=fitting)
        T_world_base, altitude = _lies(ready)
        view = View(camera, T_world_base, ready.mount, altitude, ready.devices.beams)
        account = perception.perceive(rgb, view, seen).account
    except (OSError, ValueError, RuntimeError) as error:
        return Finding("pictures", ok=False, said=str(error), wanted=wanted)
    ms = 1e3 * (time.perf_counter() - began)
    lost = account.lost / max(int(np.count_nonzero(seen)), 1)
    said = (
        f"{seen.mean():.0%} of the view, labelled in {ms:.0f} ms, with a confidence of "
        f"{account.confidence:.0%}: {_shared(account)}"
    )
    if math.isfinite(account.beside_floor):
        said += f"; depth {account.beside_floor:.2f} times the floor's, {account.agreement:.0%} of it agrees"
    if account.points:
        said += f"; {account.against} of {account.points} beams of the DVL in view contradict it"
    if account.floating > FLOATING:
        said += f"; {account.floating:.0%} of what is above the horizon is seabed: do the labels know walls?"
    if account.lost:
        said += f"; {lost:.0%} without a label"
    if account.doubt:
        said += f"; {account.doubt}"
    ok = account.confidence >= LEAST_SURE and lost <= MOST_LOST and not account.doubt
    return Finding("pictures", ok=ok, said=said, wanted=wanted)


def _shared(account: Account) -> str:
    """How much of the view has which label."""
    each = sorted(zip(account.shares, Label, strict=True), reverse=True)
    return ", ".join(f"{share:.0%} {label.name.lower()}" for share, label in each if share >= 0.005)


def _lies(ready: Ready) -> tuple[SE3, float]:
    """Where the vehicle lies, and metres above the floor; level and as high as it will dive where unknown."""
    from dream.robots.bluerov2.navigation import NotReady

    altitude = ready.protocol.altitude
    try:
        fix = ready.devices.navigator.update()
    except NotReady:
        return SE3.level(ready.start.x, ready.start.y, 0.0, ready.start.yaw), altitude
    height = float(fix.T_world_base.translation[2]) - fix.seabed
    return fix.T_world_base, height if math.isfinite(height) else altitude


def _in_time(ready: Ready) -> Finding:
    """Beat as the bridge does, while pictures are made labels and depth of: can this computer do both?"""
    from dream.robots.bluerov2.bridge import BEATS
    from dream.robots.bluerov2.check import Finding
    from dream.robots.bluerov2.navigation import NotReady
    from dream.robots.bluerov2.rov import SOON

    devices, threads = ready.devices, ready.devices.threads
    allowed = LABELLED * SOON
    wanted = (
        f"{BEATS:g} beats a second while it looks, and depth and labels of a picture within {allowed:g} s: "
        "smaller models, or a computer with nothing else to do"
    )
    late: list[float] = []
    slowest = 0.0
    over = threads.event()

    def beat() -> None:
        due = devices.now()
        while not over.is_set():
            devices.navigator.update()
            due += 1.0 / BEATS
            over.wait(max(due - devices.now(), 0.0))
            late.append(max(devices.now() - due, 0.0))
            due = max(due, devices.now() - 1.0 / BEATS)

    try:
        devices.navigator.update()
        picture, camera = devices.camera.newest(FIRST_FRAME), ready.protocol.camera
        perception = ready.sight.perception.anew
        level = SE3.level(ready.start.x, ready.start.y, 0.0, ready.start.yaw)
        beating = threads.start(beat, "beats")
        for _ in range(LOOKS):
            began = devices.now()
            rgb, _ = ready.eye.view(picture, camera)
            view = View(camera, level, ready.mount, ready.protocol.altitude)
            perception.perceive(rgb, view)
            slowest = max(slowest, devices.now() - began)
            devices.link.operator_alive()
            threads.sleep(0.1)
        over.set()
        beating.join(1.0)
    except (NotReady, OSError, ValueError, RuntimeError) as error:
        return Finding("computer", ok=False, said=f"not measured: {error}", wanted=wanted)
    missed = sum(behind > 1.0 / BEATS for behind in late) / max(len(late), 1)
    worst = max(late, default=math.inf)
    # Beside a simulated tank that takes a core for itself, it is only told.
    ok = (missed <= MISSED and worst < LEASE_SPENT and slowest <= allowed) or ready.tank is not None
    said = (
        f"{missed:.0%} of its beats late, the latest by {worst:.2f} s; a picture labelled in {slowest:.2f} s "
        "at most"
    )
    return Finding("computer", ok, said, wanted)


def _sounded(ready: Ready) -> list[Finding]:
    """Tell the DVL how fast sound goes, where that was given."""
    from dream.robots.bluerov2.check import Finding

    speed = ready.told.speed_of_sound
    if speed is None:
        return []
    try:
        said, ok = f"told {speed:g} m/s, {ready.devices.tell_sound(FIRST_REPORT)}", True
    except (ConnectionError, TimeoutError, ValueError) as error:
        said, ok = str(error), False
    return [Finding("sound", ok, said, wanted=f"a DVL that takes {speed:g} m/s for its speed of sound")]


def _pointed(ready: Ready) -> Finding:
    """Point the camera, and see where it looks, as the map depends on it; and set the lights."""
    from dream.robots.bluerov2.check import Finding
    from dream.robots.bluerov2.mavlink import Refused

    link = ready.devices.link
    tilts = [math.radians(ready.told.tilt)]
    if ready.protocol.space is not None:
        # All that the mission may ask for, and that of the launch last.
        tilts = [*(tilt for tilt in ready.protocol.tilts if tilt != ready.protocol.camera_pitch), *tilts]
    looks = " and ".join(f"{math.degrees(tilt):g}°" for tilt in tilts)
    wanted = f"a mount that looks {looks} down and says so: see MNT1_* and --tilt"
    try:
        if ready.told.lights is not None:
            link.set_lights(ready.told.lights)
        ups = [link.tilt_camera(-tilt) for tilt in tilts]
    except (Refused, RuntimeError, TimeoutError, ValueError) as error:
        return Finding("camera mount", ok=False, said=str(error), wanted=wanted)
    looks = " and ".join(f"{-math.degrees(up):.0f}°" for up in ups)
    return Finding("camera mount", ok=True, said=f"looks {looks} down")


def print_findings(found: list[Finding], *, as_json: bool) -> int:
    """Print the list; exit status 0 for go, 1 for no-go."""
    go = all(finding.ok for finding in found)
    if as_json:
        print_json({"go": go, "findings": [asdict(finding) for finding in found]})
        return 0 if go else 1
    width = max(len(finding.name) for finding in found)
    for finding in found:
        mark = "ok" if finding.ok else "NO"
        wanted = "" if finding.ok else f"   wanted: {finding.wanted}"
        print(f"  {mark}  {finding.name:<{width}}  {finding.said}{wanted}")
    wrong = sum(not finding.ok for finding in found)
    print("go" if go else f"no-go: {wrong} of {len(found)} are not well")
    return 0 if go else 1
