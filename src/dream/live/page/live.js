// A page that keeps up with missions under way. What a run says goes in as text, never as markup.

const fixed = JSON.parse(document.body.dataset.fixed);
const runs = new Map(); // by key, in the server's order
let opened = null; // key of the run that is shown whole

// Milliseconds on a clock that does not stand still while the machine sleeps, nor jump more than the wall's.
const now = () => Date.now();
const RETRY_MS = 3000;
// Three beats: one may be late.
const SILENCE_MS = 7000;
// A step older than this, of a mission that did not say that it ended, is worth a word.
const QUIET_S = 60;
const GRACE_MS = 2000;
const REDRAW_MS = 250;
const SPACE_MS = 1000;
// Of the time, spent on drawing at most, while one takes 50 ms or less: the mission may need the processors more.
const DRAWING_SHARE = 1 / 20;
// A page that was out of sight for a while must not take that for the time of its drawing.
const SLOWEST_MS = 1000;

function blank(key) {
  return { ...fixed, key, name: "", config: null, summary: null, problem: "", cap: null, real: false, depth_max: 5, steps: [], age: null, aged: 0 };
}
function runOf(key) {
  if (!runs.has(key)) runs.set(key, blank(key));
  return runs.get(key);
}

// ---- address: #run=KEY&step=N; without a step it follows the newest

const keyInAddress = () => /^#(?:.*&)?run=([0-9a-f]{8})(?:&|$)/.exec(location.hash)?.[1] ?? null;
const addressOf = (step, atEnd) => [`run=${opened}`, ...(atEnd ? [] : [`step=${step.step}`])].join("&");

// ---- view

const view = new StepView();
const player = new Player(show, addressOf);
const space = new SpaceView();
document.addEventListener("step", ({ detail }) => space.show(detail));
const chart = new Chart(at("chart"), at("curve-keys"), at("event-keys"), (index) => player.seek(index));
let asked = null;
let wantedStep = stepInAddress(); // of the address, until it has come
let following = wantedStep === null;

const live = element("button", { type: "button", className: "live", textContent: "Live", title: "Follow the newest step (End)" });
at("last").after(live);
live.addEventListener("click", () => player.seek(player.steps.length - 1));

function show(index) {
  const run = runs.get(opened);
  const step = run?.steps[index];
  if (!step?.reasoning) return;
  following = index === run.steps.length - 1;
  view.show(step, following ? undefined : run.steps[index + 1]?.step);
  asked.show(step);
  chart.show(index);
  live.setAttribute("aria-pressed", String(following));
  showBudget(run, index);
  showHealth(run, index);
}

function open(key) {
  if (opened === key) return;
  opened = key;
  const run = runs.get(key);
  run.steps = []; // They came in brief; they come again, whole.
  delete document.documentElement.dataset.ready;
  document.body.classList.add("empty");
  const base = `/runs/${key}`;
  view.open(run, (step) => Object.fromEntries(SHOWN.map((name) => [name, `${base}/${step}/${name}`])));
  asked = new Asked(at("asked"), run.steps, async (step) => {
    const answer = await fetch(`${base}/${step}/asked`).catch(() => null);
    return answer?.ok ? answer.json() : [];
  });
  at("asked").replaceChildren();
  player.open(run.steps);
  space.clear();
  spaceShown = "";
  connect();
  soon();
}

// ---- in three dimensions

let spaceShown = ""; // the run and the version of its scene that is shown
let spaceRests = -Infinity; // until then no newer one is asked for
let spaceAsked = false;

// The newest scene, at most so often, and where somebody looks.
async function bringSpace() {
  const [key, version] = [opened, runs.get(opened)?.space];
  if (!version || spaceShown === `${key}.${version}` || spaceAsked || document.hidden || now() < spaceRests) return;
  spaceAsked = true;
  const answer = await fetch(`/runs/${key}/space`).catch(() => null);
  const told = answer?.ok ? await answer.json().catch(() => null) : null;
  spaceAsked = false;
  const began = now();
  if (told && key === opened) {
    space.take(told);
    spaceShown = `${key}.${version}`;
  }
  spaceRests = now() + Math.max(SPACE_MS, (now() - began) / DRAWING_SHARE);
}

// ---- masthead and panels

function ageOf(run) {
  return known(run.age) ? run.age + (now() - run.aged) / 1000 : null;
}
const quiet = (run) => !run.summary && !run.problem && (ageOf(run) ?? 0) > QUIET_S;
const ago = (seconds) => (seconds < 90 ? `${Math.round(seconds)} s` : seconds < 5400 ? `${Math.round(seconds / 60)} min` : seconds < 172800 ? `${Math.round(seconds / 3600)} h` : `${Math.round(seconds / 86400)} days`);

// The badge of a run, its tone, and a sentence.
function stateOf(run) {
  if (run.problem) return ["Damaged", "bad", `${run.problem}. What came before is shown.`];
  if (!run.config) return ["Waiting", "", "It has not begun yet."];
  if (run.summary) {
    const { badge, tone, text } = outcome(run);
    return [badge, tone, text];
  }
  const last = run.steps.at(-1);
  if (last?.ended) return ["Ended", "good", `${ends(last)[0]}.`];
  if (!last && known(run.compilingSince) && now() - run.compilingSince < 600000)
    return ["Starting", "running", `Its program compiles what it computes with, for ${ago((now() - run.compilingSince) / 1000)} so far. A computer does so once, in a minute or two.`];
  if (!last) return ["Starting", "running", "It makes its world ready; no step is written yet."];
  if (quiet(run)) return ["Silent", "warn", `No step for ${ago(ageOf(run))}: ${known(run.compilingSince) ? "it thinks or compiles" : "it thinks"}, or it was stopped.`];
  return ["Under way", "running", known(run.cap) ? `Step ${last.step} of ${run.cap} at most.` : `Step ${last.step}.`];
}

function showMasthead(run) {
  const { config, steps, summary } = run;
  at("folder").textContent = run.name || "run folder";
  at("outcome-line").hidden = false;
  const [badge, tone, text] = stateOf(run);
  at("badge").textContent = badge;
  at("badge").className = `badge ${tone}`;
  at("outcome").textContent = text;
  document.title = `${badge}: ${config ? config.world : run.name} · DREAM live`;
  if (!config) return;
  at("world").textContent = config.world;
  at("seed").textContent = run.real ? "" : `seed ${config.seed}`;
  at("how").textContent = `explored by ${config.planner} under protocol ${config.protocol}`;
  at("words").textContent = `“${config.words.trim()}”`;
  at("words").hidden = config.words.trim() === "";
  at("orders").replaceChildren(...config.understood.map((sentence) => element("li", { textContent: sentence })));
  at("orders").hidden = config.understood.length === 0;
  const last = steps.at(-1);
  if (!last) return at("figures").replaceChildren();
  const coverage = summary?.coverage ?? last.coverage;
  const figures = [
    known(coverage?.instances) ? [`Individuals ${counted(steps)}`, hundredths(coverage.instances), " %"] : ["Explored", Math.round(last.map.explored ?? 0), " m²"],
    ["Steps", last.step, known(run.cap) ? ` of ${run.cap}` : ""],
    ["Distance", steps.reduce((way, step) => way + step.distance_m, 0).toFixed(0), " m"],
    ...(run.real ? [] : [["Contacts", steps.filter((step) => step.collided).length, ""]]),
    ["Last step", known(ageOf(run)) ? ago(ageOf(run)) : "–", " ago"],
  ];
  at("figures").replaceChildren(...figures.map(([title, value, unit]) => element("div", {}, element("dt", { textContent: title }), element("dd", {}, String(value), element("small", { textContent: unit })))));
}

function rows(list, lines) {
  list.replaceChildren(...lines.flatMap(([title, value, tone = "", more = ""]) => [
    element("dt", { textContent: title }),
    element("dd", { className: tone }, value, ...(more ? [" ", element("small", { textContent: more })] : [])),
  ]));
}

// Steps, questions and money until a step.
function showBudget(run, index) {
  const steps = run.steps.slice(0, index + 1);
  const step = steps.at(-1);
  const questions = steps.filter((one) => one.asked);
  const sum = (of) => questions.reduce((total, one) => total + of(one), 0);
  const costs = questions.map((one) => one.spent?.cost_usd);
  const waited = steps.reduce((total, one) => total + one.waited_s, 0);
  const parameters = run.config.planner_parameters ?? {};
  at("meter").hidden = !known(run.cap);
  at("meter").firstElementChild.style.width = known(run.cap) ? `${Math.min(100, (100 * step.step) / run.cap)}%` : "0";
  const lines = [
    ["Steps", String(step.step), "", known(run.cap) ? `of ${run.cap}, ${Math.max(0, run.cap - step.step)} left` : ""],
    ["Mission clock", minutes(step.time + waited), "", waited > 0 ? `${minutes(waited)} of it waiting for answers` : ""],
  ];
  if (questions.length === 0) lines.push(["Model calls", "none", "", parameters.model ? "" : "this planner asks no model"]);
  else {
    const calls = sum((one) => one.asked.requests);
    const fallbacks = sum((one) => (one.asked.fallback ? 1 : 0));
    lines.push(
      ["Model calls", count(calls), "", known(parameters.max_calls) && parameters.max_calls > 0 ? `of ${count(parameters.max_calls)}` : ""],
      ["Without a usable reply", String(fallbacks), fallbacks ? "warn" : ""],
      ["Tokens", costs.every((cost) => cost !== undefined) ? count(sum((one) => one.spent.tokens)) : "not known"],
      ["Cost", costs.every(known) ? dollars(sum((one) => one.spent.cost_usd)) : "price unknown", "", known(parameters.max_usd) ? `of US$ ${parameters.max_usd}` : ""],
    );
  }
  if (step.home) lines.push(...wayHome(step).map(([title, text, tone]) => [title, text, tone]));
  rows(at("budget"), lines);
}

// What a pilot would ask first.
function showHealth(run, index) {
  const steps = run.steps.slice(0, index + 1);
  const step = steps.at(-1);
  const cleared = steps.map((one) => one.clearance_m).filter(known);
  const least = cleared.length ? Math.min(...cleared) : null;
  const notes = steps.filter((one) => one.arrival_note);
  const touched = steps.filter((one) => one.collided).length;
  at("health-step").textContent = `at step ${step.step}`;
  const sigma = step.position_sigma_m;
  rows(at("health"), [
    ["Position", sigma > 0 ? `± ${metres(sigma, 2)}` : "taken as exact", sigma > 1 ? "warn" : "", sigma > 0 ? "one sigma" : ""],
    ["Clearance", known(step.clearance_m) ? metres(step.clearance_m) : "nothing near", known(step.clearance_m) && step.clearance_m < 0.5 ? "warn" : "", known(least) ? `least ${metres(least)}` : ""],
    ["On the way", step.arrival_note || "nothing to note", step.arrival_note ? "warn" : "", notes.length ? `${plural(notes.length, "note")} so far` : ""],
    ["Contacts", String(touched), touched ? "bad" : ""],
    ["Last decision took", step.planner_ms > 0 ? `${step.planner_ms.toFixed(step.planner_ms < 10 ? 1 : 0)} ms` : "–"],
    ["Age of the last step", known(ageOf(run)) ? ago(ageOf(run)) : "–", quiet(run) ? "warn" : "", run.summary ? "the mission has ended" : ""],
  ]);
}

// Newest first.
function showLog(run) {
  const lines = run.steps.flatMap((step) => [
    ...(step.ended ? [[step, ...ends(step)]] : []),
    ...(step.home?.why && !run.steps.find((one) => one.step === step.step - 1)?.home?.why ? [[step, `Goes home: ${step.home.why}`, "warn"]] : []),
    ...(step.home && !known(step.home.path) ? [[step, "No way home is known", "bad"]] : []),
    ...(step.collided ? [[step, "Touched something", "bad"]] : []),
    ...(step.arrival_note ? [[step, step.arrival_note, "warn"]] : []),
    ...(step.guarded?.note ? [[step, `Guard: ${step.guarded.note}`, "warn"]] : []),
    ...(step.open_region ? [[step, `Not complete: ${step.open_region}`, "refused"]] : []),
    ...(step.asked?.fallback ? [[step, `No usable reply: ${step.asked.fallback}`, "warn"]] : []),
  ]);
  const items = lines.reverse().map(([step, text, tone]) => element("li", {}, element("a", { href: `#run=${run.key}&step=${step.step}`, className: tone }, element("span", { textContent: step.step }), text)));
  at("log").replaceChildren(...(items.length ? items : [element("li", { className: "none", textContent: "Nothing out of the ordinary." })]));
}

// ---- missions side by side

const cards = new Map();
function card(run) {
  if (!cards.has(run.key)) {
    const parts = { image: element("img", { alt: "", hidden: true }), title: element("b"), by: element("span", { className: "by" }), state: element("span", { className: "state" }), curve: svg("svg", { viewBox: "0 0 100 24", preserveAspectRatio: "none", "aria-hidden": "true" }) };
    const button = element("button", { type: "button", className: "card" }, element("span", { className: "thumb" }, parts.image), parts.title, parts.by, parts.state, parts.curve);
    button.addEventListener("click", () => {
      [wantedStep, following] = [null, true];
      open(run.key);
      history.replaceState(null, "", `#run=${run.key}`);
    });
    cards.set(run.key, { ...parts, button, item: element("li", {}, button), pictured: null });
  }
  return cards.get(run.key);
}

function showCard(run) {
  const parts = card(run);
  const last = run.steps.at(-1);
  const [badge, tone] = stateOf(run);
  parts.button.setAttribute("aria-pressed", String(run.key === opened));
  parts.title.textContent = run.config ? `${run.config.world}${run.real ? "" : ` ${run.config.seed}`}` : run.name;
  parts.by.textContent = run.config ? run.config.planner : "";
  parts.button.title = run.name;
  const seen = last?.coverage?.instances;
  const extent = !last ? "" : known(seen) ? `${percent(seen)} seen` : `${Math.round(last.map.explored ?? 0)} m²`;
  parts.state.replaceChildren(element("span", { className: tone, textContent: badge }), ...(last ? [`step ${last.step}`, extent].map((textContent) => element("span", { textContent })) : []));
  // Pictures of the others are looked at now and then: they are there to tell the missions apart.
  if (last && parts.pictured !== last.step && (run.summary || !parts.drawn || now() - parts.drawn > 2000)) {
    Object.assign(parts, { pictured: last.step, drawn: now() });
    const next = new Image();
    next.src = `/runs/${run.key}/${last.step}/map`;
    next.decode().then(() => Object.assign(parts.image, { src: next.src, hidden: false }), () => {});
  }
  const { series, top } = curves(run);
  const width = Math.max(run.cap ?? 1, last?.step ?? 1);
  const points = run.steps.filter((step) => known(series[0].of(step))).map((step) => `${((100 * step.step) / width).toFixed(1)},${(23 - (22 * series[0].of(step)) / top).toFixed(1)}`);
  parts.curve.replaceChildren(svg("line", { x1: 0, x2: 100, y1: 23.5, y2: 23.5 }), svg("polyline", { points: points.join(" ") }));
}

// ---- drawing, at most so often

let drawing = 0;
let pace = REDRAW_MS;
let drawn = -Infinity;
function dirty() {
  drawing ||= setTimeout(draw, Math.max(0, drawn + pace - performance.now()));
}
// What is waited for does not wait until the last drawing has paid for itself.
function soon() {
  clearTimeout(drawing);
  [drawing, pace, drawn] = [0, REDRAW_MS, -Infinity];
  dirty();
}
function draw() {
  drawing = 0;
  const began = (drawn = performance.now());
  // By the second task after it the frame is on the screen.
  requestAnimationFrame(() => setTimeout(() => (pace = Math.min(SLOWEST_MS, Math.max(REDRAW_MS, (performance.now() - began) / DRAWING_SHARE)))));
  at("missions").hidden = runs.size < 2;
  if (runs.size > 1) {
    const items = [...runs.values()].map((run) => (showCard(run), card(run).item));
    if (items.some((item, index) => at("cards").children[index] !== item) || at("cards").children.length !== items.length) at("cards").replaceChildren(...items);
  }
  const run = runs.get(opened);
  if (!run) return;
  showMasthead(run);
  if (!run.config || run.steps.length === 0 || !caughtUp) return;
  document.body.classList.remove("empty");
  const grown = player.travelled.length !== run.steps.length;
  const was = player.current;
  if (grown) {
    player.open(run.steps);
    showLog(run);
    at("asked-panel").hidden = !run.steps.some((step) => step.asked);
  }
  if (grown || run.redraw) {
    run.redraw = false;
    chart.open(run);
    at("curve-name").textContent = chart.plot.top === 1 ? "Coverage" : "Explored ground";
  }
  if (wantedStep !== null) {
    player.show(nearest(run.steps, wantedStep));
    wantedStep = null;
  } else if (grown && following && !player.timer) player.show(run.steps.length - 1);
  else if (grown) {
    following = was === run.steps.length - 1;
    player.place();
    live.setAttribute("aria-pressed", String(following));
  }
  live.hidden = run.summary !== null;
  showHealth(run, player.current);
  document.documentElement.dataset.ready = String(run.steps.length);
}

// ---- connection

let source = null;
let heard = now();
let tried = now(); // when a connection was last begun, or given up
let retry = 0;
let caughtUp = false; // with all that there is of the run that is open
let broken = null; // since when there is no connection, on our clock

const positions = () => [...runs.values()].filter((run) => run.steps.length).map((run) => `${run.key}.${run.steps.length}`).join("-");

function connect() {
  clearTimeout(retry);
  source?.close();
  caughtUp = false;
  tried = now();
  source = new EventSource(`/events?open=${opened ?? ""}&have=${positions()}`);
  source.addEventListener("runs", ({ data }) => hearRuns(JSON.parse(data)));
  source.addEventListener("run", ({ data }) => hearRun(JSON.parse(data)));
  source.addEventListener("again", ({ data }) => hearAgain(JSON.parse(data)));
  source.addEventListener("step", ({ data }) => hearStep(JSON.parse(data)));
  source.addEventListener("space", ({ data }) => hearSpace(JSON.parse(data)));
  source.addEventListener("beat", ({ data }) => hearBeat(JSON.parse(data)));
  source.addEventListener("error", () => {
    tried = now();
    broken ??= tried;
    // What the browser gave up, as it does where the server is full, is tried again here.
    if (source.readyState === EventSource.CLOSED) retry = setTimeout(connect, RETRY_MS);
  });
}

function hearRuns({ runs: keys, waiting, left_out: leftOut }) {
  const kept = new Map(keys.map((key) => [key, runOf(key)]));
  runs.clear();
  kept.forEach((run, key) => runs.set(key, run));
  for (const key of cards.keys()) if (!runs.has(key)) cards.delete(key);
  at("waiting").hidden = waiting.length === 0;
  at("waiting").textContent = `Waiting for a run in ${waiting.join(", ")}. It appears by itself.`;
  at("missions-note").textContent = `${keys.length} side by side${leftOut ? `, ${leftOut} older ones left out` : ""}; press one to see it whole`;
  if (!runs.has(opened)) {
    opened = null;
    const wanted = keyInAddress();
    if (keys.length) open(runs.has(wanted) ? wanted : keys[0]);
  }
  dirty();
}

function hearRun(head) {
  const run = runOf(head.run);
  Object.assign(run, { name: head.name, config: head.config, summary: head.summary, problem: head.problem, cap: head.cap, compilingSince: known(head.compiling_s) ? now() - 1000 * head.compiling_s : null, inset: head.inset ?? null, lattice: head.lattice ?? null, redraw: true });
  run.real = head.config !== null && isReal(head.config);
  if (head.run === opened) view.writeAxes(run.inset);
  dirty();
}

function hearAgain({ run }) {
  runOf(run).steps.length = 0;
  if (run === opened) player.travelled.length = 0;
  dirty();
}

function hearStep({ run: key, index, step }) {
  const { steps } = runOf(key);
  if (index > steps.length) return connect(); // Something is missing: ask again from where it is whole.
  if (index === steps.length) steps.push(step);
  dirty();
}

function hearSpace({ run, version }) {
  runOf(run).space = version;
  bringSpace();
}

function hearBeat({ ages }) {
  heard = now();
  for (const [key, age] of Object.entries(ages)) if (runs.has(key)) Object.assign(runs.get(key), { age, aged: now() });
  if (!caughtUp) soon();
  caughtUp = true;
  broken = null;
  at("lost").hidden = true;
  at("link").textContent = "connected";
  at("link").className = "link good";
  dirty();
}

function lose() {
  const run = runs.get(opened);
  const age = run && known(ageOf(run)) ? ` The newest step shown is ${ago(ageOf(run))} old.` : "";
  at("link").textContent = "not connected";
  at("link").className = "link bad";
  at("lost").textContent = `No connection; trying again.${age}`;
  at("lost").hidden = false;
}

// A connection can also die without a word, or be taken by what never answers. One that was answered is given up
// but once: its server may still read what there is. One that comes back at once is not worth a word.
setInterval(() => {
  const unanswered = source.readyState !== EventSource.OPEN;
  if ((broken === null || unanswered) && now() - Math.max(heard, tried) > SILENCE_MS) {
    connect();
    broken ??= now();
  }
  if (broken !== null && now() - broken > GRACE_MS) lose();
  bringSpace();
  dirty();
}, 1000);

addEventListener("hashchange", () => {
  const key = keyInAddress() ?? opened;
  const step = stepInAddress();
  if (runs.has(key) && key !== opened) {
    [wantedStep, following] = [step, step === null];
    open(key);
  } else if (step !== null && player.steps.length) player.seek(nearest(player.steps, step));
});

connect();
// So that keys scroll it as they scroll a page without a player.
document.querySelector(".page").focus({ preventScroll: true });
