"""Arm, dive, explore, and leave all of it on disk."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dream.commands.console import print_json, told_without_answer
from dream.commands.dive.console import Operator, Reading, Will, console, tell
from dream.commands.dive.records import config, print_outcome, summary
from dream.commands.progress import stage, with_progress
from dream.ending import also, reason
from dream.errors import MissionAborted
from dream.geometry import SE2
from dream.planning import AnyPlanner
from dream.types import Setpoint

if TYPE_CHECKING:
    from dream.commands.dive.ready import Ready
    from dream.commands.dive.terminal import Terminal
    from dream.evaluation.metrics import Logbook
    from dream.homeward import Budget
    from dream.robots.bluerov2.bridge import Bridge, Standing
    from dream.robots.bluerov2.home import WayHome
    from dream.robots.bluerov2.navigation import Fix
    from dream.robots.bluerov2.rov import BlueRov2, Manners
    from dream.robots.bluerov2.sight import Sight
    from dream.types import Step

logger = logging.getLogger(__name__)

_ENDS = {Will.END: "ended by the operator", Will.SURFACE: "the operator wants it at the surface"}


@dataclass
class Flight:
    """One mission of a dive that is ready."""

    ready: Ready
    name: str
    """Of the planner."""
    last: Step | None = None
    """The last one that was made."""

    def fly(self, interrupted: Callable[[], None], terminal: Terminal) -> int:
        """Arm, dive, explore, and leave all of it on disk.

        Args:
            interrupted: Raises the KeyboardInterrupt that compiled code may have swallowed.
            terminal: Where it is shown.

        Returns:
            Exit status 0, or 1 where no answer of its model counted.

        Raises:
            MissionAborted: The mission did not end by itself; it says why, and what is kept.
        """
        from dream.recording import room_kept

        # The log goes on while the vehicle comes home, and would fill what is left of a disk.
        with room_kept(self.ready.folder) as give_free:
            return self._fly(interrupted, terminal, give_free)

    def _fly(self, interrupted: Callable[[], None], terminal: Terminal, give_free: Callable[[], None]) -> int:
        """The same, with room for the summary until it is given free."""
        from dream import recording
        from dream.evaluation.metrics import Logbook, Scorer
        from dream.mapping import OccupancyMap
        from dream.mission import explore
        from dream.robots.bluerov2.bridge import LEASE, Bridge
        from dream.robots.bluerov2.drives import AltHold, Guided
        from dream.robots.bluerov2.home import WayHome
        from dream.robots.bluerov2.sight import Sight
        from dream.robots.replay import Keeping

        ready, name = self.ready, self.name
        told, devices, protocol = ready.told, ready.devices, ready.protocol
        began = time.perf_counter()
        recording.write_config(ready.folder, config(ready, name, told.homing.budget()))
        ready.known.keep(ready.folder)
        link = devices.link
        home = WayHome(link, ready.limits, devices.now, person=ready.steered, threads=devices.threads)
        drive = (Guided if told.drive == "guided" else AltHold)(link, link.joystick(), home)
        sight = Sight(devices.camera)
        bridge = Bridge(
            devices.navigator,
            drive,
            ready.limits,
            devices.now,
            pilot=devices.station,
            said=self._log_standing,
            fixed=self._log_fix,
            failing=devices.failing,
            sight=sight,
            aimed=self._log_goal,
            threads=devices.threads,
        )
        operator = Operator(
            willed=lambda will: self._willed(bridge, home, will),
            # Who sees nothing any more is none, from the moment when the terminal last took something.
            alive=lambda idle: None if told.unattended else bridge.renew_operator(LEASE - idle),
        )
        vehicle, tank = self._robot(bridge, operator, sight), ready.tank
        logbook: Logbook = Logbook(protocol) if tank is None else Scorer(tank.world, protocol)
        stopped: BaseException | None = None
        try:
            # All that can fail before is done: from here on, whatever comes, the vehicle is brought home.
            if link.busy:
                raise MissionAborted(f"vehicle: {link.busy}")
            link.set_mode("GUIDED" if told.drive == "guided" else "ALT_HOLD")
            link.arm()
            bridge.start()
            title = f"{name} · {ready.folder.name}"
            with console(title, lambda: self._readings(bridge), operator, terminal) as shown:
                vehicle.go_to(self._launch(bridge.fix))
                occupancy = OccupancyMap(ready.limits.area, protocol)
                robot = Keeping(vehicle, ready.folder)
                steps = explore(
                    robot,
                    _in_real_time(told.planner),
                    occupancy,
                    max_steps=told.max_steps,
                    prior=ready.known.prior,
                    budget=self._budget(bridge),
                    ticking=True,
                )
                recorded = recording.record(
                    self._logged(steps, vehicle),
                    ready.folder,
                    annotate=lambda step: self._annotated(step, logbook, vehicle),
                )
                with contextlib.closing(recorded):
                    total = told.max_steps or protocol.cap
                    bar = with_progress(recorded, name, total, "steps", at_most=True)
                    for _ in recorded if shown else bar:
                        interrupted()
        except (KeyboardInterrupt, Exception) as error:  # noqa: BLE001 - whatever it was, what was flown is kept.
            stopped = error
        finally:
            try:
                bridge.close()
            finally:
                home.finish(lambda line: tell(line, quiet=told.json))
        came = summary(ready, name, logbook, bridge, vehicle, time.perf_counter() - began, stopped)
        give_free()
        return self._end(came, self._summed_up(came, stopped))

    def _summed_up(self, came: Mapping[str, Any], stopped: BaseException | None) -> BaseException | None:
        """Write the summary. A disk that is full takes nothing from the reason of an abort: it joins it."""
        from dream.recording import write_summary

        try:
            write_summary(self.ready.folder, came)
        except OSError as full:
            return also(stopped, full)
        return stopped

    def _end(self, came: Mapping[str, Any], stopped: BaseException | None) -> int:
        """Tell what came of it and leave the page.

        Returns:
            Exit status 0, or 1 where no answer of its model counted.

        Raises:
            MissionAborted: By what stopped it.
        """
        from dream.evaluation.metrics import without_answer
        from dream.report import write_report

        folder = self.ready.folder
        if lost := {name: count for name, count in self.ready.devices.log.lost.items() if count}:
            which = ", ".join(f"{count} of {name}" for name, count in lost.items())
            logger.warning("the log is not whole, messages are lost: %s. Was the disk full?", which)
        if stopped is not None and not (folder / "steps.jsonl").is_file():
            what = reason(stopped)
            raise MissionAborted(f"aborted: {what}; no step was made. The log is kept in {folder}")
        page: Path | None = None
        try:
            with stage("writing report.html"):
                page = write_report(folder)
        except OSError as full:
            stopped = also(stopped, full)
        if self.ready.told.json:
            print_json(came)
        else:
            print_outcome(came, page)
        if stopped is not None:
            said = f"aborted: {reason(stopped)}; {came['steps']} steps are kept in {folder}"
            raise MissionAborted(said if page else f"{said}. Once there is room: dream report {folder}")
        return told_without_answer(without_answer(came["vlm"]))

    def _robot(self, bridge: Bridge, operator: Operator, sight: Sight) -> BlueRov2:
        from dream.planning.vlm import Asking
        from dream.protocol import SHOWN
        from dream.robots.bluerov2.rov import BlueRov2

        ready, planner = self.ready, self.ready.told.planner
        return BlueRov2(
            bridge,
            ready.devices.navigator,
            ready.eye,
            ready.sight.perception,
            ready.protocol,
            ready.devices.now,
            frozen=lambda: sight.frozen,
            T_base_camera=ready.mount,
            mount=ready.devices.link,
            fineness=SHOWN if isinstance(planner, Asking) else 1,
            manners=_manners(planner),
            waits=lambda: operator.will is not Will.GO,
            holds=lambda: operator.will is Will.HOLD,
            truth=None if ready.tank is None else ready.tank.truth,
            threads=ready.devices.threads,
            beams=lambda: ready.devices.beams,
            vehicle=lambda: ready.devices.link.telemetry,
            homing_voltage=ready.limits.homing_voltage,
        )

    def _budget(self, bridge: Bridge) -> Budget | None:
        """What the mission may spend from here on: it is home before the minutes of the dive are over."""
        from dream.recording import write_config

        budget = self.ready.told.homing.budget()
        if budget is not None:
            left = max(math.floor(bridge.seconds_left), 1)
            budget = replace(budget, seconds=min(budget.seconds, left))
            try:
                budget.check(self.ready.limits.area, self.ready.protocol)
            except ValueError as error:
                raise MissionAborted(f"--minutes: the launch left {left} s: {error}") from None
            # A replay has to turn home where the dive does.
            write_config(self.ready.folder, config(self.ready, self.name, budget))
        return budget

    def _willed(self, bridge: Bridge, home: WayHome, will: Will) -> None:
        """The operator's word is the last: also where a joystick is broken, or its station gone."""
        from dream.robots.bluerov2.limits import LastResort

        station = self.ready.devices.station
        self._log("operator", {"wants": str(will)})
        if will in _ENDS:
            if station is not None:
                station.dismiss()
            if will is Will.SURFACE:
                home.begin(LastResort.SURFACE)
            bridge.end(_ENDS[will])
        elif will is Will.GO and station is not None:
            station.release()

    def _logged(self, steps: Iterator[Step], vehicle: BlueRov2) -> Iterator[Step]:
        """Tell the log of each decision, and how far what was then seen can be believed."""
        doubt = trouble = ""
        for step in steps:
            account = vehicle.accounts[-1]
            self._log("perception", {"step": step.index, **account.said()})
            if account.doubt and account.doubt != doubt:
                logger.warning("step %d: %s", step.index, account.doubt)
            doubt = account.doubt
            if step.observation.trouble and not trouble:
                trouble = step.observation.trouble
                logger.warning("step %d: %s: the mission goes home", step.index, trouble)
            self.last, decision = step, step.decision
            told = {
                "step": step.index,
                "turn": decision.turn,
                "advance": decision.advance,
                "climb": decision.climb,
                "tilt": decision.tilt,
                "done": decision.done,
                "note": step.guarded.note,
                "reasoning": asdict(decision.reasoning),
                "arrival": step.arrival.note,
            }
            self._log("decision", told)
            yield step

    def _annotated(self, step: Step, logbook: Logbook, vehicle: BlueRov2) -> Mapping[str, Any]:
        from dream.evaluation.metrics import Scorer

        perception = {"perception": vehicle.accounts[-1].said()}
        if isinstance(logbook, Scorer):
            return {"coverage": logbook.add(step).as_dict(), **perception}
        logbook.note(step)
        return perception

    def _log(self, channel: str, told: Mapping[str, Any]) -> None:
        """What DREAM itself decides, as of now."""
        self.ready.devices.log.tap(self.ready.devices.now(), channel, True, told)

    def _log_standing(self, standing: Standing) -> None:
        self._log("standing", {"stance": str(standing.stance), "reason": standing.reason})
        if standing.reason:
            logger.warning("%s: %s", standing.stance, standing.reason)

    def _launch(self, fix: Fix) -> Setpoint:
        """Where the mission begins: at the protocol's altitude, or at the height that this is here."""
        ready, start = self.ready, self.ready.start
        if ready.protocol.space is None:
            return Setpoint(start.x, start.y, start.yaw, ready.protocol.altitude)
        if not math.isfinite(fix.seabed):
            raise MissionAborted("dive: expected the DVL to see the floor, got none. How deep is it here?")
        return Setpoint(start.x, start.y, start.yaw, None, ready.protocol.launch_height(fix.seabed))

    def _log_goal(self, goal: SE2, altitude: float | None, z: float | None) -> None:
        held = {"z": z} if altitude is None else {"altitude": altitude}
        self._log("goal", {"x": goal.x, "y": goal.y, "yaw": goal.yaw, **held})

    def _log_fix(self, fix: Fix) -> None:
        self.ready.devices.log.tap(fix.time, "estimate", False, fix)

    def _readings(self, bridge: Bridge) -> list[Reading]:
        """What the operator's console shows."""
        from dream.robots.bluerov2.check import battery_told
        from dream.robots.bluerov2.limits import LOW_SHARE

        devices, standing, fix = self.ready.devices, bridge.standing, bridge.fix
        said, pose, goal = devices.link.telemetry, bridge.fix.T_world_base.se2, bridge.goal
        low = said.voltage < self.ready.limits.homing_voltage or said.battery <= LOW_SHARE
        here = f"{pose.x:+.2f} {pose.y:+.2f} m, heading {math.degrees(pose.yaw):+.0f}°"
        there = "none" if goal is None else f"{goal.x:+.2f} {goal.y:+.2f} m, {math.degrees(goal.yaw):+.0f}°"
        ages = (
            f"IMU {fix.imu_age:.2f}, depth {fix.depth_age:.2f}, DVL {fix.dvl_age:.2f}, "
            f"camera {devices.camera.age:.2f} s"
        )
        station = devices.station
        return [
            Reading(
                "it",
                f"{standing.stance}: {standing.reason}" if standing.reason else str(standing.stance),
                not standing.reason,
            ),
            Reading("step", "none yet" if self.last is None else self._step_line(self.last)),
            Reading("vehicle", f"{said.mode}, {'armed' if said.armed else 'disarmed'}", said.armed),
            *([] if station is None else [Reading("pilot", station.words, not station.gone)]),
            Reading("is at", f"{here} ± {fix.position_sigma:.2f} m"),
            Reading("goes to", there),
            Reading("depth", f"{said.depth:.2f} m, {fix.altitude:.2f} m above the floor"),
            Reading("battery", battery_told(said), not low),
            Reading("ages", ages, max(fix.imu_age, fix.dvl_age - 0.8, devices.camera.age - 0.8) < 0.2),
            Reading("camera", devices.camera.problem or "well", devices.camera.connected),
            Reading("DVL", devices.dvl.problem or "well", not devices.dvl.problem),
            Reading("log", devices.log.problem or f"{devices.log.written} messages", not devices.log.problem),
        ]

    def _step_line(self, step: Step) -> str:
        total = self.ready.told.max_steps or self.ready.protocol.cap
        return f"{step.index} of {total} at most. {step.decision.reasoning.action}"


def _manners(planner: AnyPlanner) -> Manners:
    """How long a planner may think: one that asks a model, for as long as it waits for an answer."""
    from dream.planning.vlm import Asking
    from dream.robots.bluerov2.rov import Manners

    thinking = Manners().thinking
    return Manners(thinking=planner.timeout + thinking) if isinstance(planner, Asking) else Manners()


def _in_real_time(planner: AnyPlanner) -> AnyPlanner:
    """A planner that asks a model, with no time to be waited for an answer but that which it takes."""
    from dream.planning.vlm import Asking

    return replace(planner, latency=None) if isinstance(planner, Asking) else planner
