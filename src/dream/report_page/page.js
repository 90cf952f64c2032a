// The page: what the run says goes in as text, never as markup.

const run = JSON.parse(document.getElementById("run").textContent);
const { steps, summary, config } = run;
const at = (id) => document.getElementById(id);

function element(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

const travelled = [];
steps.forEach((step, index) => travelled.push((travelled[index - 1] ?? 0) + step.distance_m));
const collisions = steps.filter((step) => step.collided).length;
// With a real vehicle: its map has a frame of its own, and there is no truth.
const real = known(config.dive) && !config.dive.stand_in;

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
at("asked-panel").hidden = inAll === null;

function figure(title, value, unit = "") {
  at("figures").append(element("div", {}, element("dt", { textContent: title }), element("dd", {}, value, element("small", { textContent: unit }))));
}
const coverage = summary?.coverage ?? steps.at(-1)?.coverage;
if (known(coverage?.instances)) figure("Targets seen", hundredths(coverage.instances), " %");
else figure("Explored", Math.round(steps.at(-1)?.map.explored ?? 0), " m²");
figure("Steps", summary?.steps ?? steps.at(-1)?.step ?? 0);
const t90 = summary ? summary.t90 : steps.find((step) => step.coverage?.instances >= 0.9)?.step;
if (known(coverage?.instances)) figure("90 % seen after", known(t90) ? t90 : "–", known(t90) ? " steps" : "");
figure("Distance", (summary?.distance_m ?? travelled.at(-1) ?? 0).toFixed(0), " m");
if (!real) figure("Collisions", summary?.collisions ?? collisions);

// ---- one step

const FIELDS = [
  ["distribution", "Where targets are"],
  ["target_area", "Where I am among them"],
  ["completion", "What is complete"],
  ["next_target", "Where to go next"],
  ["safety", "What is in the way"],
  ["action", "What to do"],
];
const said = FIELDS.map(([field, title], index) => {
  const text = element("p");
  const item = element("li", {}, element("span", { className: "number", textContent: index + 1, ariaHidden: "true" }), element("h3", { textContent: title }), text);
  at("reasoning").append(item);
  return { field, item, text };
});
const silence = element("li", { className: "none", textContent: "Nothing was said at this step." });
at("reasoning").append(silence);

function carried(step) {
  const row = (title, text, tone = "") => [element("dt", { textContent: title }), element("dd", { textContent: text, className: tone })];
  if (step.step === 0) return row("Moved", "Not yet: this is the first look, before anything was decided");
  const rows = row("Asked", move(step.decision));
  if (guardChanged(step)) rows.push(...row("Guard", `${move(step.guarded)}${step.guarded.note ? `: ${step.guarded.note}` : ""}`, "warn"));
  if (step.open_region) rows.push(...row("Refused", `Not complete: ${step.open_region}`, "refused"));
  const room = known(step.clearance_m) ? `, ${metres(step.clearance_m)} clear` : "";
  const how = step.distance_m > 0.005 ? `${metres(step.distance_m, 2)} to` : "On the spot at";
  rows.push(...row("Moved", `${how} ${place(step.pose, !real)}${room}`));
  if (step.arrival_note) rows.push(...row("On the way", step.arrival_note, "warn"));
  if (step.waited_s > 0) rows.push(...row("Waited", `${minutes(step.waited_s)} for the model`));
  if (step.collided) rows.push(...row("Contact", "Touched something and stopped", "bad"));
  if (step.ended) rows.push(...row("Ended", step.ended === "done" ? "The planner is done and the map agrees" : "Out of steps", step.ended === "done" ? "good" : "warn"));
  return rows;
}

// How much of the picture each label takes.
function showShares() {
  const parts = pictures.shares();
  shares.forEach(({ filled, share }, label) => {
    filled.style.width = parts ? `${100 * parts[label]}%` : "0";
    share.textContent = parts ? percent(parts[label]) : "–";
  });
}

const pictures = new Pictures(run);
const asked = new Asked(at("asked"), steps);
const slider = at("slider");
const values = [];
let current = 0;
let chart = null;
let settle = 0;

function show(index) {
  current = Math.min(Math.max(index, 0), steps.length - 1);
  const step = steps[current];
  if (!step) return;
  pictures.show(step.step, steps[current + 1]?.step).then(showShares);
  slider.value = current;
  slider.style.setProperty("--fill", `${(100 * current) / Math.max(1, steps.length - 1)}%`);
  slider.setAttribute("aria-valuetext", `step ${step.step} of ${steps.at(-1).step}`);
  at("counter").replaceChildren(`Step ${step.step} `, element("small", { textContent: `of ${steps.at(-1).step} · ${metres(travelled[current], 0)}` }));
  for (const { field, item, text } of said) {
    text.textContent = step.reasoning[field].trim();
    item.hidden = text.textContent === "";
  }
  silence.hidden = said.some(({ item }) => !item.hidden);
  at("reasoning").scrollTop = 0;
  at("thought-step").textContent = step.planner_ms > 0 ? `decided in ${step.planner_ms.toFixed(step.planner_ms < 10 ? 1 : 0)} ms` : "";
  at("map-areas").textContent = [["explored", "explored"], ["target", "target"]]
    .filter(([layer]) => known(step.map[layer]))
    .map(([layer, word]) => `${step.map[layer].toFixed(layer === "target" ? 1 : 0)} m² ${word}`)
    .join(" · ");
  at("map").setAttribute("aria-label", `The map after step ${step.step}`);
  at("carried").replaceChildren(...carried(step));
  if (inAll) asked.show(step);
  chart?.show(current);
  for (const { node, of } of values) node.textContent = known(of(step)) ? chart.plot.say(of(step)) : "–";
  // Browsers limit how often an address may change, so it follows once the step has settled.
  clearTimeout(settle);
  settle = setTimeout(() => history.replaceState(null, "", `#step=${step.step}`), 250);
}

// ---- playing

let timer = 0;
function pause() {
  clearInterval(timer);
  timer = 0;
  at("play").setAttribute("aria-pressed", "false");
  at("play").setAttribute("aria-label", "Play");
}
function play() {
  if (current === steps.length - 1) show(0);
  clearInterval(timer);
  timer = setInterval(() => {
    show(current + 1);
    if (current === steps.length - 1) pause();
  }, 1000 / Number(at("speed").value));
  at("play").setAttribute("aria-pressed", "true");
  at("play").setAttribute("aria-label", "Pause");
}
const toggle = () => (timer ? pause() : play());
function seek(index) {
  pause();
  show(index);
}

at("play").addEventListener("click", toggle);
at("first").addEventListener("click", () => seek(0));
at("back").addEventListener("click", () => seek(current - 1));
at("forward").addEventListener("click", () => seek(current + 1));
at("last").addEventListener("click", () => seek(steps.length - 1));
at("speed").addEventListener("change", () => timer && play());
slider.addEventListener("input", () => seek(Number(slider.value)));
document.addEventListener("keydown", (event) => {
  if (event.altKey || event.ctrlKey || event.metaKey || event.target.closest("select, details, pre")) return;
  const jump = { ArrowLeft: current - 1, ArrowRight: current + 1, PageUp: current - 10, PageDown: current + 10, Home: 0, End: steps.length - 1 }[event.key];
  if (jump !== undefined) seek(jump);
  else if (event.key === " " && !event.target.closest("button, a")) toggle();
  else return;
  event.preventDefault();
});
function follow() {
  const asked = /^#step=(\d{1,6})$/.exec(location.hash);
  if (asked) seek(chart.nearest(Number(asked[1])));
  return asked !== null;
}
addEventListener("hashchange", follow);

// ---- camera

at("depth-max").textContent = `${run.depth_max} m`;
pictures.drawDepthScale(at("depth-scale"));
const shares = [];
for (const { name, color } of run.labels) {
  const swatch = element("span", { className: "swatch" });
  swatch.style.backgroundColor = `rgb(${color.join(" ")})`;
  const filled = element("span");
  const share = element("output");
  at("shares").append(element("li", {}, swatch, name, element("span", { className: "bar" }, filled), share));
  shares.push({ filled, share });
}
for (const name of ["rgb", "depth", "labels"]) {
  at(name).addEventListener("pointermove", (event) => {
    const box = at(name).getBoundingClientRect();
    at("probe").textContent = pictures.probe((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  });
  at(name).addEventListener("pointerleave", () => (at("probe").textContent = ""));
}

// ---- chart

chart = new Chart(run, at("chart"), seek);
if (chart.plot.top !== 1) at("curve-name").textContent = "Explored ground";
for (const { name, title, of } of chart.plot.series) {
  const node = element("b");
  const key = svg("svg", { viewBox: "0 0 26 12", "aria-hidden": "true" }, svg("line", { class: name, x1: 1, x2: 25, y1: 6, y2: 6 }));
  at("curve-keys").append(element("li", {}, key, title, node));
  values.push({ node, of });
}
if (summary && chart.plot.top === 1) {
  const key = svg("svg", { viewBox: "0 0 26 12", "aria-hidden": "true" }, svg("line", { class: "goal", x1: 1, x2: 25, y1: 6, y2: 6 }));
  at("curve-keys").append(element("li", {}, key, "98.26 %, needed for a success"));
}
for (const { name, title, steps: when } of chart.events) {
  const key = svg("svg", { viewBox: "0 0 12 12", "aria-hidden": "true" }, svg("rect", { class: `event-${name}`, x: 4, y: 1, width: 4, height: 10, rx: 1.5 }));
  at("event-keys").append(element("li", {}, key, `${title} (${when.length})`));
}

// ---- summary

const orNever = (step) => (known(step) ? `${step} steps` : "not reached");
const share = (value) => (known(value) ? percent(value) : "not measured");
function tables() {
  const coverage = summary.coverage;
  const measured = known(coverage.instances);
  return [
    ["Seen", measured ? [
      ["Individuals", share(coverage.instances), "target individuals that were in view, within reach and unobstructed"],
      ["Groups", share(coverage.clusters), "groups of which at least half the individuals were seen"],
      ["Area", share(coverage.area), "target ground (of a wreck: hull surface) seen"],
      ...(known(coverage.visible) ? [["In the pictures", share(coverage.visible), "individuals that showed at least three pixels within reach in some frame"]] : []),
    ] : [["Targets", "not measured", "nobody knows what there was to see"]]],
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
      ["Collisions", known(summary.collisions) ? String(summary.collisions) : "unknown", "contacts with terrain, boulders or hull"],
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
function modelRows(vlm) {
  return [
    ["Calls", count(vlm.calls), known(vlm.questions) ? `messages sent, for ${plural(vlm.questions, "question")}` : "messages sent"],
    ["Tokens", count(vlm.tokens), known(vlm.tokens_in) ? `${count(vlm.tokens_in)} in, ${count(vlm.tokens_out)} out` : ""],
    ["Cost", dollars(vlm.cost_usd), "by the client's list of prices"],
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
    ? `Positions are metres in the map's frame, which the launch fixed; headings are degrees counter-clockwise from its x. `
    : `Shares compare with the truth, which the planner never sees. ` +
      `Positions are metres east and north of the centre; headings are degrees counter-clockwise from east.`) +
  (summary?.world_hash ? ` World hash ${summary.world_hash.slice(0, 16)}.` : "");

slider.max = Math.max(0, steps.length - 1);
document.body.classList.toggle("empty", steps.length === 0);
// A reader first wants to see what came of it; the way there is a press of Home and play away.
if (!follow()) show(steps.length - 1);
document.documentElement.dataset.ready = String(steps.length);
