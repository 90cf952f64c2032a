// One step: what it sees, knows and thinks. The report shows it, and so does the page of a mission under way.

const at = (id) => document.getElementById(id);

function element(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

// With a real vehicle there is no truth, and the launch fixed where up is on its map.
const isReal = (config) => known(config.dive) && !config.dive.stand_in;

// The steps by which the paper reasons; a planner that takes fewer says nothing under the others.
const FIELDS = [
  ["distribution", "Where targets are"],
  ["target_area", "Where I am among them"],
  ["completion", "What is complete"],
  ["next_target", "Where to go next"],
  ["safety", "What is in the way"],
  ["action", "What to do"],
];

// Where a move ends beside what was asked: only where moves end on a lattice, and nothing else came between.
function onLattice(step, lattice) {
  const other = Math.abs(step.distance_m - Math.hypot(step.guarded.advance, step.guarded.climb ?? 0)) > 0.05;
  if (!known(lattice) || !other || step.collided || step.arrival_note) return "";
  return ` Moves end at the nearest point of a lattice of ${lattice} m, so that ${metres(step.guarded.advance, 0)} ahead became ${metres(step.distance_m, 2)}.`;
}

// How it stands with the way home: a title, a text and a tone for each line.
function wayHome(step) {
  const { path, why } = step.home;
  if (!known(path)) return [["Way home", "No way is known", "bad"]];
  if (path.length === 0) return [["Way home", "It is home", why ? "good" : ""]];
  const lines = balances(step).map(({ way, margin, left, name, short }) => [`Home by ${name}`, `${way}, ${margin} more at most; left: ${left}`, short ? "warn" : ""]);
  return [...(why ? [["Goes home", why, "warn"]] : []), ...lines];
}

function carried(step, { lattice, real }) {
  const row = (title, text, tone = "") => [element("dt", { textContent: title }), element("dd", { textContent: text, className: tone })];
  if (step.step === 0) return row("Moved", "Not yet: this is the first look, before anything was decided");
  const rows = row("Asked", move(step.decision));
  if (guardChanged(step)) rows.push(...row("Guard", `${move(step.guarded)}${step.guarded.note ? `: ${step.guarded.note}` : ""}`, "warn"));
  if (step.open_region) rows.push(...row("Refused", `Not complete: ${step.open_region}`, "refused"));
  const room = known(step.clearance_m) ? `, ${metres(step.clearance_m)} clear` : "";
  const how = step.distance_m > 0.005 ? `${metres(step.distance_m, 2)} to` : "On the spot at";
  rows.push(...row("Moved", `${how} ${place(step.pose, real)}${room}.${onLattice(step, lattice)}`));
  if (step.arrival_note) rows.push(...row("On the way", step.arrival_note, "warn"));
  if (step.waited_s > 0) rows.push(...row("Waited", `${minutes(step.waited_s)} for the model`));
  if (step.collided) rows.push(...row("Contact", "Touched something and stopped", "bad"));
  if (!step.ended && step.why) rows.push(...row("Ended", step.why, "bad"));
  if (step.home) rows.push(...wayHome(step).flatMap((line) => row(...line)));
  if (step.ended) rows.push(...row("Ended", ...ends(step)));
  return rows;
}

class StepView {
  constructor() {
    this.run = null;
    this.said = FIELDS.map(([field, title]) => {
      const text = element("p");
      const item = element("li", {}, element("h3", { textContent: title }), text);
      at("reasoning").append(item);
      return { field, item, text };
    });
    this.silence = element("li", { className: "none", textContent: "The planner said nothing at this step." });
    at("reasoning").append(this.silence);
    for (const name of ["rgb", "depth", "labels"]) {
      at(name).addEventListener("pointermove", (event) => {
        const box = at(name).getBoundingClientRect();
        at("probe").textContent = this.pictures.probe((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
      });
      at(name).addEventListener("pointerleave", () => (at("probe").textContent = ""));
    }
  }

  // A run: its `labels`, `depth_level`, `depth_max`, and whether it is `real`; and where its pictures are.
  open(run, sourcesOf) {
    this.run = run;
    const scale = () => (at("depth-max").textContent = `${run.depth_max} m`);
    this.pictures = new Pictures(run, sourcesOf, scale);
    this.pictures.drawDepthScale(at("depth-scale"));
    scale();
    this.shares = run.labels.map(({ name, color }) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.backgroundColor = `rgb(${color.join(" ")})`;
      const filled = element("span");
      const share = element("output");
      return { filled, share, item: element("li", {}, swatch, name, element("span", { className: "bar" }, filled), share) };
    });
    at("shares").replaceChildren(...this.shares.map(({ item }) => item));
    this.writeAxes(run.inset);
  }

  // Metres beside the map, and what its colours mean.
  writeAxes(inset) {
    if (!inset) return;
    const ticks = (lines, side) => lines.map(([metres, share]) => {
      const tick = element("span", { textContent: metres });
      tick.style[side] = `${100 * share}%`;
      return tick;
    });
    at("map-down").replaceChildren(...ticks(inset.down, "top"));
    at("map-across").replaceChildren(...ticks(inset.across, "left"));
    const keys = inset.legend.map(({ name, color }) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.backgroundColor = `rgb(${color.join(" ")})`;
      return element("li", {}, swatch, name);
    });
    const north = this.run.real ? "up is the y of the map" : "north is up";
    const says =
      `Squares of the grid are ${metres(inset.grid, inset.grid % 1 ? 1 : 0)} wide; ${north}. Explored: the floor was seen within reach. ` +
      "Free: nothing stands there, as it was launched there or looked through it, but the floor was not seen. " +
      "Both: solid and a target, as a wreck's side is.";
    at("map-legend").replaceChildren(...keys, element("li", { className: "say", textContent: says }));
  }

  // `next` is the number of the step whose pictures are wanted soon.
  show(step, next) {
    this.pictures.show(step.step, next).then(() => this.showShares());
    for (const { field, item, text } of this.said) {
      text.textContent = step.reasoning[field].trim();
      item.hidden = text.textContent === "";
    }
    this.silence.hidden = this.said.some(({ item }) => !item.hidden);
    at("reasoning").scrollTop = 0;
    at("thought-step").textContent = step.planner_ms > 0 ? `decided in ${step.planner_ms.toFixed(step.planner_ms < 10 ? 1 : 0)} ms` : "";
    at("map-areas").textContent = [["explored", "explored"], ["target", "target"]]
      .filter(([layer]) => known(step.map[layer]))
      .map(([layer, word]) => `${step.map[layer].toFixed(layer === "target" ? 1 : 0)} m² ${word}`)
      .join(" · ");
    at("map").setAttribute("aria-label", `The map after step ${step.step}`);
    at("carried").replaceChildren(...carried(step, this.run));
  }

  // How much of the picture each label takes.
  showShares() {
    const parts = this.pictures.shares();
    this.shares.forEach(({ filled, share }, label) => {
      filled.style.width = parts ? `${100 * parts[label]}%` : "0";
      share.textContent = parts ? percent(parts[label]) : "–";
    });
  }
}
