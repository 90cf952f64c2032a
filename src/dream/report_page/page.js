// The page: what the run says goes in as text, never as markup.

const run = JSON.parse(document.getElementById("run").textContent);
const { steps, summary, config } = run;
const collisions = steps.filter((step) => step.collided).length;
const real = isReal(config);

// ---- masthead

const end = outcome(run);
at("world").textContent = config.world;
at("seed").textContent = real ? "" : `seed ${config.seed}`;
at("how").textContent = `explored by ${config.planner} under protocol ${config.protocol}`;
at("badge").textContent = end.badge;
at("badge").classList.add(...[end.tone].filter(Boolean));
at("outcome").textContent = end.text;

at("words").textContent = `“${config.words.trim()}”`;
at("words").hidden = config.words.trim() === "";
at("orders").append(...config.understood.map((sentence) => element("li", { textContent: sentence })));
at("orders").hidden = config.understood.length === 0;

const inAll = askedInAll(run);
at("asked-total").textContent = askedSentence(run);
at("without-answer").hidden = !withoutAnswer(summary?.vlm);
at("without-answer-why").textContent = summary?.vlm?.last_fallback ? `The last had none because of ${summary.vlm.last_fallback}.` : "";
at("asked-panel").hidden = inAll === null;

function figure(title, value, unit = "") {
  at("figures").append(element("div", {}, element("dt", { textContent: title }), element("dd", {}, value, element("small", { textContent: unit }))));
}
const coverage = summary?.coverage ?? steps.at(-1)?.coverage;
if (known(coverage?.instances)) figure(`Individuals ${counted(steps)}`, hundredths(coverage.instances), " %");
else figure("Explored", Math.round(steps.at(-1)?.map.explored ?? 0), " m²");
figure("Steps", summary?.steps ?? steps.at(-1)?.step ?? 0);
const t90 = summary ? summary.t90 : steps.find((step) => step.coverage?.instances >= 0.9)?.step;
if (known(coverage?.instances)) figure(`90 % ${counted(steps)} after`, known(t90) ? t90 : "–", known(t90) ? " steps" : "");
figure("Distance", (summary?.distance_m ?? steps.reduce((way, step) => way + step.distance_m, 0)).toFixed(0), " m");
if (!real) figure("Contacts", summary?.collisions ?? collisions);

// ---- one step

const blockOf = (name) => JSON.parse(document.getElementById(name)?.textContent ?? "null");
const view = new StepView();
const asked = new Asked(at("asked"), steps, (step) => blockOf(`asked-${step}`) ?? []);
const player = new Player(show);
const chart = new Chart(at("chart"), at("curve-keys"), at("event-keys"), (index) => player.seek(index));

function show(index) {
  const step = steps[index];
  view.show(step, steps[index + 1]?.step);
  if (inAll) asked.show(step);
  chart.show(index);
}

view.open(Object.assign(run, { real }), (step) => blockOf(`pictures-${step}`) ?? {});
chart.open(run);
if (chart.plot.top !== 1) at("curve-name").textContent = "Explored ground";

// ---- summary

const orNever = (step) => (known(step) ? `${step} steps` : "not reached");
const share = (value) => (known(value) ? percent(value) : "not measured");
function tables() {
  const coverage = summary.coverage;
  const measured = known(coverage.instances);
  return [
    measured ? found(coverage, summary.inspection) : ["Seen", [["Targets", "not measured", "nobody knows what there was to see"]]],
    ["Steps", [
      ...(measured ? [
        ["To 90 %", orNever(summary.t90), "of the individuals"],
        ["To 95 %", orNever(summary.t95), ""],
        ["To 98.26 %", orNever(summary.t98), "the mark that a success needs"],
        ["To 100 %", orNever(summary.t100), ""],
      ] : []),
      ["First claim", known(summary.t_claimed) ? `step ${summary.t_claimed}` : "none", "when the planner first held the mission to be complete"],
      ["Own stop", known(summary.t_stop) ? `step ${summary.t_stop}` : "none", "when it stopped and the map's completion check agreed"],
      ["In all", String(summary.steps), "decisions carried out, the look-around at the start included"],
    ]],
    ["Motion", [
      ["Distance", metres(summary.distance_m), "travelled over ground"],
      ["Turns", String(summary.turns), "steps that changed the heading"],
      ...(known(summary.guarded) ? [["Guarded", plural(summary.guarded, "move"), "that the guard shortened or refused"]] : []),
      ["Contacts", known(summary.collisions) ? String(summary.collisions) : "unknown", "with terrain, boulders or hull"],
      ["Least clearance", known(summary.min_clearance_m) ? metres(summary.min_clearance_m, 2) : "unknown", "between the body and anything solid"],
    ]],
    ["Computation", [
      ["Decision, median", known(summary.planner_ms.p50) ? `${summary.planner_ms.p50.toFixed(1)} ms` : "–", "time the planner took"],
      ["Decision, slowest 1 %", known(summary.planner_ms.p99) ? `${summary.planner_ms.p99.toFixed(1)} ms` : "–", ""],
      ["Whole run", `${summary.wall_s.toFixed(1)} s`, `on the clock, ${summary.dive ? "" : "simulation and "}recording included`],
      ...(known(summary.mission_s) ? [["Mission", minutes(summary.mission_s), "on its own clock, waiting for answers included"]] : []),
    ]],
    ...(summary.vlm ? [["The model", modelRows(summary.vlm)]] : []),
  ];
}
// Shares of what there was to find. In space that is to be inspected: near enough, in the image, unobstructed, and not at a slant.
function found(coverage, inspection) {
  const how = inspection ? "inspected" : "seen";
  const counts = inspection
    ? "of which a fifth of the surface was within reach, in one picture, unobstructed and at no more than the protocol's angle"
    : "that were in view, within reach and unobstructed";
  return [inspection ? "Inspected" : "Seen", [
    ["Individuals", share(coverage.instances), `${counts}; an individual is one thing that is counted, as a clump of oysters, 0.5 m of hull or a shell in a tank`],
    ["Patches", share(coverage.clusters), `of which at least half the individuals were ${how}; a patch is individuals that lie together`],
    ["Area", share(coverage.area), `target ground (of a wreck: hull surface) ${how}`],
    ...(inspection ? [
      ["All surface", share(inspection.whole), "inspected, with what nothing the vehicle can do would show"],
      ["Left out", share(inspection.dropped), "of all surface, for that reason: it does not count above"],
      ["At any angle", share(inspection.seen), "of the individuals that count were seen at all"],
    ] : []),
    ...(known(coverage.visible) ? [["In the pictures", share(coverage.visible), "individuals that showed at least three pixels within reach in some frame"]] : []),
  ]];
}
function modelRows(vlm) {
  return [
    ["Calls", count(vlm.calls), known(vlm.questions) ? `messages sent, for ${plural(vlm.questions, "question")}` : "messages sent"],
    ["Tokens", count(vlm.tokens), known(vlm.tokens_in) ? `${count(vlm.tokens_in)} in, ${count(vlm.tokens_out)} out` : ""],
    ["Cost", dollars(vlm.cost_usd), known(vlm.cost_usd) ? "by the client's list of prices" : ""],
    ...(outcomes(vlm) ? [["Answers", outcomes(vlm), "what came of them"]] : []),
    ["Fallbacks", String(vlm.fallbacks), `questions without a usable reply${reasons(vlm)}`],
    ...(known(vlm.waited_s) ? [["Waited", minutes(vlm.waited_s), "on the mission's clock, standing still"]] : []),
  ];
}
function diveRows({ dive, position_error_m: error }) {
  const milliseconds = ({ p50, p99 }) => `${p50.toFixed(0)} ms, ${p99.toFixed(0)} ms`;
  const counted = (counts) => Object.entries(counts).map(([what, times]) => `${what} (${times})`).join(", ") || "none";
  return [
    ...(known(error) ? [["Position error", `${metres(error.rmse, 3)} rms`, "from where it believed to be to where it was"]] : []),
    ["Steered by", `${dive.estimator}, ${dive.drive}`, "what reckoned the pose, and how the vehicle was moved"],
    ["Goal to command", milliseconds(dive.command_lag_ms), "median and slowest 1 %"],
    ["Late beats", String(dive.late_beats), "of the 25 a second that steer"],
    ["Age of a picture", milliseconds(dive.picture_age_ms), "when it was taken for a step; median and slowest 1 %"],
    ["Pictures", `${dive.pictures_per_s.toFixed(1)} / s`, `${plural(dive.packets_lost, "packet")} lost`],
    ["Link", percent(1 - dive.link_loss), "of the vehicle's messages came"],
    ["Refused", counted(dive.refused), "messages that were not believed"],
    ["Not in the log", counted(dive.log_lost), ""],
  ];
}
function tableOf([title, rows]) {
  const lines = rows.map(([name, value, meaning]) =>
    element("tr", {}, element("th", { scope: "row", textContent: name }), element("td", { className: "value", textContent: value }), element("td", { className: "meaning", textContent: meaning })),
  );
  return element("table", {}, element("caption", { textContent: title }), element("tbody", {}, ...lines));
}
if (summary) {
  const [seen, steps, motion, computation, ...others] = tables().map(tableOf);
  const links = summary.dive ? [tableOf(["Vehicle and links", diveRows(summary)])] : [];
  at("summary").append(element("div", { className: "tables" }, element("div", {}, seen, motion, ...others), element("div", {}, steps, computation, ...links)));
} else at("summary").append(element("p", { textContent: "This run wrote no summary. What is shown here is all that was recorded." }));
at("config").textContent = JSON.stringify(config, null, 2);

// ---- footer

at("command").textContent = run.command;
at("provenance").textContent =
  `Made by DREAM ${config.version}${config.commit ? ` (${config.commit.slice(0, 10)})` : ""}, from the files of this run alone. ` +
  `The numbers hold under protocol ${config.protocol}, which fixes the sensor and the moves. ` +
  (real
    ? `Positions are metres in the map's frame, which the launch fixed; headings are degrees clockwise from up on the map, its y. `
    : `Shares compare with the truth, which the planner never sees. ` +
      `Positions are metres east and north of the centre; headings are degrees by compass: 0° is north, 90° east.`) +
  (summary?.world_hash ? ` World hash ${summary.world_hash.slice(0, 16)}.` : "");

document.body.classList.toggle("empty", steps.length === 0);
function follow() {
  const wanted = stepInAddress();
  if (wanted !== null) player.seek(nearest(steps, wanted));
  return wanted !== null;
}
addEventListener("hashchange", follow);
player.open(steps);
// A reader first wants to see what came of it; the way there is a press of Home and play away.
if (!follow()) player.seek(steps.length - 1);
// So that keys scroll it as they scroll a page without a player.
document.querySelector(".page").focus({ preventScroll: true });
document.documentElement.dataset.ready = String(steps.length);
