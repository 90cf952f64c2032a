// Numbers and outcomes in plain words. Angles are radians; a reader gets degrees.

const degrees = (radians) => Math.round((radians * 180) / Math.PI);
const metres = (value, digits = 1) => `${value.toFixed(digits)} m`;
// Only what is whole is called 100.
const hundredths = (share) => (share >= 1 ? "100" : Math.min(100 * share, 99.9).toFixed(1));
const percent = (share) => `${hundredths(share)} %`;
const known = (value) => value !== null && value !== undefined;
const plural = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

// As a compass counts: clockwise from up on the map, which is north where the map has one.
const compass = (yaw) => (((90 - degrees(yaw)) % 360) + 360) % 360;

// What counts: what is seen, or what is inspected of a vehicle that moves in three dimensions.
const inSpace = ({ pose }) => known(pose.z);
const counted = (steps) => (steps.length && inSpace(steps[0]) ? "inspected" : "seen");

function place({ x, y, z, yaw, tilt }, real) {
  const names = ["north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"];
  const towards = real ? "on the map" : `(${names[Math.round(compass(yaw) / 45) % 8]})`;
  const depth = known(z) ? `, ${metres(-z)} deep` : "";
  return `(${x.toFixed(1)}, ${y.toFixed(1)})${depth}, heading ${compass(yaw)}° ${towards}${known(tilt) ? `, camera ${looks(tilt)}` : ""}`;
}

const looks = (tilt) => (degrees(tilt) === 0 ? "level" : `${Math.abs(degrees(tilt))}° ${tilt > 0 ? "down" : "up"}`);

function move(decision) {
  if (decision.done) return "Declare the mission complete";
  const angle = degrees(decision.turn);
  const parts = [];
  if (angle !== 0) parts.push(Math.abs(angle) === 180 ? "turn around" : `turn ${Math.abs(angle)}° ${angle > 0 ? "left" : "right"}`);
  if (decision.advance > 0) parts.push(`advance ${Number(decision.advance.toFixed(2))} m`);
  if (decision.climb) parts.push(`${decision.climb > 0 ? "climb" : "sink"} ${Number(Math.abs(decision.climb).toFixed(2))} m`);
  if (known(decision.tilt)) parts.push(`tilt the camera ${looks(decision.tilt)}`);
  const text = parts.join(", then ") || "hold and look again";
  return text[0].toUpperCase() + text.slice(1);
}

const guardChanged = ({ decision, guarded }) =>
  guarded.note !== "" || Math.abs(decision.turn - guarded.turn) > 1e-9 || Math.abs(decision.advance - guarded.advance) > 1e-9 ||
  Math.abs((decision.climb ?? 0) - (guarded.climb ?? 0)) > 1e-9 || (decision.tilt ?? null) !== (guarded.tilt ?? null);

// Whether more was spent than it had.
const late = ({ home }) => Boolean(home?.balances.some(({ left }) => left < 0));

// How a mission ended by itself, and whether that is well.
const ends = (step) => ({
  done: [inSpace(step) ? "The planner is done" : "The planner is done and the map agrees", "good"],
  returned: late(step) ? ["It turned round and is home, late", "warn"] : ["It turned round and is home", "good"],
  cap: ["Out of steps", "warn"],
})[step.ended];

// What is left beside what the way home takes; empty where no way is known.
const balances = ({ home }) => home.balances.map(({ name, unit, left, way, margin }) => {
  const amount = (value) => (unit === "s" ? minutes(value) : `${value.toFixed(unit === "Wh" || unit === "turns" ? 1 : 0)} ${unit}`);
  return { name, left: left < 0 ? `${amount(-left)} too much` : amount(left), way: amount(way), margin: amount(margin), short: way + margin > left };
});

// Whether it called the mission complete before its steps were used up, and the map did not agree.
function claims(steps) {
  const refused = steps.filter((step) => step.open_region);
  if (refused.length === 0) return " without calling the mission complete";
  const times = refused.length === 1 ? `at step ${refused[0].step}` : `${refused.length} times, first at step ${refused[0].step}`;
  return `; it called the mission complete ${times}, but the map's own check did not agree`;
}

// What a dive that was cut short says of the computer that flew it.
function slow({ dive }) {
  if (!dive?.late_beats) return "";
  return ` This computer did not keep up: of the 25 beats a second that steer the vehicle, ${dive.late_beats} came late. Close other programs on it, or dive with a faster one.`;
}

function outcome(run) {
  const { summary, steps } = run;
  const last = steps.at(-1);
  // Older files do not say why; a program that was killed could not.
  const because = (why) => (why ? `: ${why}` : "");
  if (!summary) {
    if (last?.ended) return { badge: "Not scored", tone: "", text: `It ended after step ${last.step}, but left no summary.` };
    const when = last ? `after step ${last.step}` : "before its first step";
    const silent = last?.why ? "" : " It left no word why: the program was killed, or the power failed, or it is still under way.";
    return { badge: "Aborted", tone: "bad", text: `It was aborted ${when}${because(last?.why)}.${silent} ${last ? "Everything recorded until then is shown." : "Nothing was recorded."}` };
  }
  const where = `of the individuals ${run.config.orders ? "in the ordered area " : ""}${counted(steps)}`;
  // Of a real dive nobody knows what there was to see, nor whether it touched anything.
  const parts = [];
  if (known(summary.coverage.instances)) parts.push(`${percent(summary.coverage.instances)} ${where}`);
  if (known(summary.collisions)) parts.push(summary.collisions ? plural(summary.collisions, "contact") : "no contact");
  const came = parts.length ? `, with ${parts.join(" and ")}` : "";
  if (summary.ended === "done") {
    const well = summary.success ?? true;
    return { badge: summary.success ? "Success" : "Done", tone: well ? "good" : "warn", text: `It stopped by itself at step ${summary.t_stop ?? summary.steps}${came}.` };
  }
  if (summary.ended === "returned") {
    const why = summary.home?.why;
    return { badge: "Returned", tone: last && late(last) ? "warn" : "good", text: `It turned round and was home after ${plural(summary.steps, "step")}${came}${why ? `: ${why}` : ""}.` };
  }
  if (summary.ended === "cap")
    return { badge: "Out of steps", tone: "warn", text: `It used all ${summary.steps} steps${came}${claims(steps)}.` };
  return { badge: "Aborted", tone: "bad", text: `It was aborted after ${plural(summary.steps, "step")}${came}${because(summary.why)}.${slow(summary)}` };
}
