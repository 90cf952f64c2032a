// A page at which a person flies: keys and buttons put a step together, and the mission carries it out.

const rules = JSON.parse(document.body.dataset.fixed);
const RETRY_MS = 1500;
const SAME = 1e-6;

let view = null; // what the server told last
let version = ""; // of it
let composed = blank();
let sending = false;

function blank() {
  return { turn: 0, advance: 0, climb: 0, tilt: null };
}

// ---- one step, in degrees and metres

const same = (one, other) => Math.abs(one - other) < SAME;
const modulo = (value, by) => ((value % by) + by) % by;

// The next turn to one side that the protocol allows, at least so many degrees on; a full circle of them.
function turned(turn, side, least) {
  const on = (other) => modulo(side * (other - turn), 360);
  const others = rules.turns.filter((other) => on(other) > SAME && on(other) > least - SAME);
  return others.sort((one, other) => on(one) - on(other))[0] ?? turn;
}

// The next of some rising values, or the last that way.
function moved(values, value, way, most) {
  const beyond = values.filter((other) => way * (other - value) > SAME);
  return (most === (way > 0) ? beyond.at(-1) : beyond[0]) ?? value;
}

// The value of a list that is nearest.
const nearestOf = (values, value) => values.reduce((best, other) => (Math.abs(other - value) < Math.abs(best - value) ? other : best));
const tiltNow = () => nearestOf(rules.tilts, (view.pose.tilt * 180) / Math.PI);

function tilted(tilt, way, most) {
  const now = tiltNow();
  const wanted = moved(rules.tilts, tilt ?? now, way, most);
  return same(wanted, now) ? null : wanted;
}

// What a key does to a step: its first is the key that is shown.
const CONTROLS = [
  { keys: ["a", "arrowleft"], group: "turn", word: "left", act: (step, most) => (step.turn = turned(step.turn, 1, most ? 90 : 0)) },
  { keys: ["d", "arrowright"], group: "turn", word: "right", act: (step, most) => (step.turn = turned(step.turn, -1, most ? 90 : 0)) },
  { keys: ["w", "arrowup"], group: "ahead", word: "more", act: (step, most) => (step.advance = moved(rules.advances, step.advance, 1, most)) },
  { keys: ["s", "arrowdown"], group: "ahead", word: "less", act: (step, most) => (step.advance = moved(rules.advances, step.advance, -1, most)) },
  { keys: ["r"], group: "height", word: "up", space: true, act: (step, most) => (step.climb = moved(rules.climbs, step.climb, 1, most)) },
  { keys: ["f"], group: "height", word: "down", space: true, act: (step, most) => (step.climb = moved(rules.climbs, step.climb, -1, most)) },
  { keys: ["t"], group: "camera", word: "up", space: true, act: (step, most) => (step.tilt = tilted(step.tilt, -1, most)) },
  { keys: ["g"], group: "camera", word: "down", space: true, act: (step, most) => (step.tilt = tilted(step.tilt, 1, most)) },
].filter((control) => rules.space || !control.space);

const radians = (angle) => (angle * Math.PI) / 180;
const asDecision = (step) => ({ done: false, turn: radians(step.turn), advance: step.advance, climb: step.climb, tilt: known(step.tilt) ? radians(step.tilt) : null });

// In fewer words than `move`: it stands beside the keys that put it together.
function inWords({ done, turn, advance, climb, tilt }) {
  if (done) return "the mission is complete";
  const angle = degrees(turn);
  const parts = [
    ...(angle ? [Math.abs(angle) === 180 ? "turn around" : `turn ${Math.abs(angle)}° ${angle > 0 ? "left" : "right"}`] : []),
    ...(advance ? [`${advance} m ahead`] : []),
    ...(climb ? [`${climb > 0 ? "climb" : "sink"} ${Math.abs(climb)} m`] : []),
    ...(known(tilt) ? [`camera ${looks(tilt)}`] : []),
  ];
  return parts.join(", ") || "look again from here";
}

const isEmpty = (step) => step.turn === 0 && step.advance === 0 && step.climb === 0 && step.tilt === null;
const mine = () => view?.state === "waiting" && view.helm === "yours" && !sending;

function press(control, most) {
  if (!mine()) return;
  const fast = at("fast").checked;
  const step = fast ? blank() : composed;
  control.act(step, most);
  if (!fast) return showNext();
  if (!isEmpty(step)) send(step);
}

async function send(step, done = false) {
  if (!mine()) return;
  sending = true;
  at("refused").hidden = true;
  showNext();
  const said = { step: view.step, turn_deg: step.turn, advance_m: step.advance, climb_m: step.climb, tilt_deg: step.tilt, done };
  const answer = await fetch("/decide", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(said) }).catch(() => null);
  sending = false;
  if (answer?.ok) composed = blank();
  else complain(answer ? await answer.text() : "No connection: nothing was sent.");
  showNext();
}

function complain(text) {
  at("refused").textContent = text.trim();
  at("refused").hidden = false;
}

const go = () => (isEmpty(composed) ? complain("Nothing is put together yet. H looks again from where it is; a step is spent on it.") : send(composed));

function ask() {
  if (!mine()) return;
  at("sure-says").textContent = rules.space
    ? "The mission ends with this word, whatever was not inspected yet."
    : "The mission ends where the map agrees. Where it names a place that is still open, a step is spent and it goes on.";
  at("sure").showModal();
}

// ---- what is shown

function showState() {
  const [word, tone] = {
    starting: ["Starting", ""],
    waiting: view.helm === "yours" ? ["Your turn", "good"] : ["Somebody's turn", ""],
    flying: ["Flying", "warn"],
    over: ["Over", ""],
  }[view.state];
  at("state").textContent = word;
  at("state").className = `badge ${tone}`;
  document.title = `${word} · DREAM fly`;
  const watching = { theirs: "Another page is at the helm; this one watches.", free: "Nobody is at the helm." }[view.helm] ?? "";
  const ended = view.last?.ended === "done" ? "The mission ended by your word." : view.last?.ended === "cap" ? "All steps are spent." : "";
  at("say").textContent = view.state === "over" ? [ended, ...(view.outcome ?? [])].join(" ") : view.state === "starting" ? "It looks around once: a quarter turn, three times. On its first use a computer compiles for a minute or two before." : watching;
  at("take").hidden = view.helm !== "free" || view.state === "over";
  if (!known(view.flown)) return;
  at("counter").textContent = `Step ${view.flown} of ${view.most}`;
  at("meter").style.width = `${(100 * view.flown) / view.most}%`;
}

function showNext() {
  const free = mine();
  for (const button of document.querySelectorAll(".helm button:not(#take)")) button.disabled = !free;
  if (view?.state === "flying") at("next").textContent = inWords(view.decision);
  else if (view?.state === "over") at("next").textContent = "none: the mission is over";
  else if (view?.state === "waiting" && view.helm !== "yours") at("next").textContent = "–";
  else if (isEmpty(composed)) at("next").replaceChildren(element("span", { className: "nothing", textContent: at("fast").checked ? "each key goes at once" : "nothing yet: press keys, then Enter" }));
  else at("next").textContent = inWords(asDecision(composed));
  showAhead();
}

function rows(list, lines) {
  list.replaceChildren(...lines.flatMap(([title, value]) => [element("dt", { textContent: title }), element("dd", { textContent: value })]));
}

function showTold() {
  const { pose, last, areas, heights } = view;
  if (!pose) return;
  rows(at("where"), [
    ["Position", `${pose.x.toFixed(1)}, ${pose.y.toFixed(1)} m`.replaceAll("-", "−")],
    ["Heading", `${compass(pose.yaw)}°`],
    ...(known(pose.z) ? [["Under water", metres(-pose.z)], ["Camera", looks(pose.tilt)]] : []),
  ]);
  at("areas").textContent = [["explored", "explored"], ["target", "target"]].filter(([layer]) => known(areas[layer])).map(([layer, word]) => `${areas[layer].toFixed(layer === "target" ? 1 : 0)} m² ${word}`).join(" · ");
  at("last").replaceChildren(...(last ? carried({ clearance_m: null, collided: false, arrival_note: "", waited_s: 0, why: "", ...last }, { lattice: null, real: false }) : []));
  at("heights").hidden = heights.length === 0;
  at("heights").replaceChildren(...heights.map((line) => element("li", { textContent: line })));
}

const KNOWN = [["map", "From above"], ["level", "Level"], ["slice", "Upright"]];
let shown = "map";
let pictured = 0; // the number of the view whose pictures are shown

function picture(id, name) {
  const next = new Image();
  next.src = `/pictures/${view.number}/${name}`;
  const { number } = view;
  next.decode().then(() => {
    if (number < pictured) return;
    at(id).src = next.src;
    at(id).hidden = false;
    if (id === "known") showAhead();
  }, () => {});
}

function showPictures() {
  if (view.pictures.length === 0) return;
  pictured = view.number;
  for (const name of ["camera", "depth", "labels"]) picture(name, name);
  const names = KNOWN.filter(([name]) => view.pictures.includes(name));
  if (!view.pictures.includes(shown)) shown = "map";
  picture("known", shown);
  at("known").alt = names.find(([name]) => name === shown)[1];
  if (names.length < 2) return;
  at("tabs").replaceChildren(...names.map(([name, title], index) => {
    const tab = element("button", { type: "button" }, title, element("kbd", { textContent: index + 1 }));
    tab.setAttribute("aria-pressed", String(name === shown));
    tab.addEventListener("click", () => choose(name));
    return tab;
  }));
}

function choose(name) {
  if (!view?.pictures.includes(name)) return;
  shown = name;
  showPictures();
}

// Where the step that is put together leads, over a map of the ground: what lies there is not looked at.
function showAhead() {
  const on = view?.inset;
  const shows = on && shown !== "slice" && view.state === "waiting" && !isEmpty(composed) && !at("known").hidden;
  if (!shows) return at("ahead").replaceChildren();
  const [width, height] = on.picture;
  at("ahead").setAttribute("viewBox", `0 0 ${width} ${height}`);
  const [west, south, east, north] = on.bounds;
  const place = (x, y) => [on.left + ((x - west) / (east - west)) * on.width, on.top + ((north - y) / (north - south)) * on.height];
  const { x, y, yaw } = view.pose;
  const heading = yaw + radians(composed.turn);
  const along = (far, aside = 0) => place(x + far * Math.cos(heading) - aside * Math.sin(heading), y + far * Math.sin(heading) + aside * Math.cos(heading));
  const far = composed.advance;
  const tip = 0.04 * (east - west);
  const line = svgOf("path", { d: `M${place(x, y)}L${along(far)}` });
  const arrow = svgOf("path", { class: "tip", d: `M${along(far + tip)}L${along(far, 0.4 * tip)}L${along(far, -0.4 * tip)}Z` });
  at("ahead").replaceChildren(line, arrow);
}

function svgOf(tag, attributes) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

function show(told) {
  const before = view;
  view = told;
  version = `${told.number}-${told.helm}`;
  if (before && told.step !== before.step) at("refused").hidden = true;
  showState();
  showTold();
  if (told.state !== "flying" && told.number !== before?.number) showPictures();
  showNext();
  document.documentElement.dataset.flown = String(told.flown ?? "");
}

// ---- keys and buttons

const groups = new Map();
for (const control of CONTROLS) {
  const button = element("button", { type: "button", title: `${control.group} ${control.word}; with Shift the greatest` }, `${control.group} ${control.word}`, element("kbd", { textContent: control.keys[0].toUpperCase() }));
  button.addEventListener("click", (event) => press(control, event.shiftKey));
  if (!groups.has(control.group)) groups.set(control.group, element("div", { className: "pad" }));
  groups.get(control.group).append(button);
}
at("pads").replaceChildren(...groups.values());

at("lattice").textContent = known(rules.lattice) ? `Moves end on a lattice of ${rules.lattice} m.` : "";

at("go").addEventListener("click", go);
at("clear").addEventListener("click", clear);
at("hold").addEventListener("click", () => send(blank()));
at("done").addEventListener("click", ask);
at("take").addEventListener("click", () => fetch("/take", { method: "POST" }).catch(() => null));
at("fast").addEventListener("change", () => {
  at("fast").blur();
  clear();
});
at("sure-no").addEventListener("click", () => at("sure").close());
at("sure-yes").addEventListener("click", () => {
  at("sure").close();
  send(blank(), true);
});
at("sure").addEventListener("keydown", (event) => {
  const button = { y: "sure-yes", n: "sure-no" }[event.key.toLowerCase()];
  if (button) at(button).click();
});

function clear() {
  composed = blank();
  at("refused").hidden = true;
  showNext();
}

document.addEventListener("keydown", (event) => {
  if (at("sure").open || event.ctrlKey || event.altKey || event.metaKey) return;
  const key = event.key.toLowerCase();
  const onButton = document.activeElement?.tagName === "BUTTON" && document.activeElement !== at("go");
  const control = CONTROLS.find(({ keys }) => keys.includes(key));
  if (control) press(control, event.shiftKey);
  else if ((key === "enter" || key === " ") && !onButton && !event.repeat) go();
  else if (key === "escape") clear();
  else if (key === "h" && !event.repeat) send(blank());
  else if (key === "c") ask();
  else if (key === "m") at("fast").click();
  else if (/^[1-3]$/.test(key) && view) choose(KNOWN[Number(key) - 1][0]);
  else return;
  event.preventDefault();
});

// ---- connection

async function follow() {
  for (;;) {
    const answer = await fetch(`/view?has=${version}`).catch(() => null);
    if (answer?.status === 200) show(await answer.json());
    else if (!answer?.ok) {
      if (view?.state === "over") return;
      at("state").textContent = "Not connected";
      at("state").className = "badge bad";
      at("say").textContent = answer ? (await answer.text()).trim() : "No connection; trying again. What was flown is kept.";
      version = "";
      await new Promise((resume) => setTimeout(resume, RETRY_MS));
    }
    if (view?.state === "over" && view.outcome) return;
  }
}

showNext();
follow();
