// The coverage curve as inline SVG, drawn for the width it has.

const SVG = "http://www.w3.org/2000/svg";

function svg(tag, attributes = {}, ...children) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

// What can be drawn: shares of what there was to see, or, where nobody knew that, explored ground.
function curves(run) {
  const how = counted(run.steps);
  const series = [
    { name: "instances", title: `Individuals ${how}`, of: (step) => step.coverage?.instances },
    { name: "clusters", title: `Patches, half ${how}`, of: (step) => step.coverage?.clusters },
    { name: "area", title: `Target area ${how}`, of: (step) => step.coverage?.area },
  ].filter(({ of }) => run.steps.some((step) => known(of(step))));
  if (series.length) return { series, top: 1, say: percent, ticks: [0, 0.25, 0.5, 0.75, 1], tick: (value) => `${100 * value} %` };
  const explored = { name: "instances", title: "Explored ground", of: (step) => step.map.explored };
  const most = Math.max(1, ...run.steps.map((step) => explored.of(step) ?? 0));
  const nice = 10 ** Math.floor(Math.log10(most));
  const stride = [0.25, 0.5, 1, 2, 2.5].map((factor) => factor * nice).find((size) => most / size <= 5);
  const ticks = Array.from({ length: Math.ceil(most / stride) + 1 }, (_, index) => index * stride);
  const say = (value) => `${value.toFixed(stride % 1 ? 1 : 0)} m²`;
  return { series: [explored], top: ticks.at(-1), say, ticks, tick: say };
}

const EVENTS = [
  { name: "collision", title: "contact", of: (step) => step.collided },
  { name: "guard", title: "guard changed the move", of: guardChanged },
  { name: "refused", title: "claim of completion refused", of: (step) => step.open_region !== "" },
];

// Index of the recorded step nearest to a step number.
function nearest(steps, number) {
  let best = 0;
  steps.forEach((candidate, index) => {
    if (Math.abs(candidate.step - number) < Math.abs(steps[best].step - number)) best = index;
  });
  return best;
}

class Chart {
  // Holders of the drawing, of the keys to its curves and of the keys to its events.
  constructor(holder, keys, eventKeys, seek) {
    Object.assign(this, { run: null, holder, keys, eventKeys, index: 0 });
    const drag = (event) => {
      if (!this.run || (event.type === "pointermove" && event.buttons !== 1)) return;
      const box = holder.getBoundingClientRect();
      const at = (event.clientX - box.left - this.left) / (this.width - this.left - this.right);
      seek(nearest(this.run.steps, at * this.end));
    };
    holder.addEventListener("pointerdown", drag);
    holder.addEventListener("pointermove", drag);
    new ResizeObserver(() => this.run && this.layout()).observe(holder);
  }

  // Draw a run, or what it has become.
  open(run) {
    this.run = run;
    this.index = Math.min(this.index, Math.max(0, run.steps.length - 1));
    this.plot = curves(run);
    this.events = EVENTS.map((event) => ({ ...event, steps: run.steps.filter(event.of) })).filter(({ steps }) => steps.length);
    this.values = this.plot.series.map(({ of }) => ({ node: element("b"), of }));
    this.keys.replaceChildren(...this.plot.series.map(({ name, title }, index) => element("li", {}, this.lineKey(name), title, this.values[index].node)));
    if (run.summary && this.plot.top === 1) this.keys.append(element("li", {}, this.lineKey("goal"), "98.26 %, needed for a success"));
    this.eventKeys.replaceChildren(...this.events.map(({ name, title, steps }) => {
      const key = svg("svg", { viewBox: "0 0 12 12", "aria-hidden": "true" }, svg("rect", { class: `event-${name}`, x: 4, y: 1, width: 4, height: 10, rx: 1.5 }));
      return element("li", {}, key, `${title} (${steps.length})`);
    }));
    this.layout();
  }

  lineKey(name) {
    return svg("svg", { viewBox: "0 0 26 12", "aria-hidden": "true" }, svg("line", { class: name, x1: 1, x2: 25, y1: 6, y2: 6 }));
  }

  x(step) {
    return this.left + (step / this.end) * (this.width - this.left - this.right);
  }

  y(value) {
    return this.topEdge + (1 - value / this.plot.top) * (this.bottomEdge - this.topEdge);
  }

  layout() {
    const { steps, summary } = this.run;
    this.width = Math.max(this.holder.clientWidth, 260);
    this.left = 52;
    this.right = 14;
    this.topEdge = 26;
    const narrow = this.width < 560;
    this.bottomEdge = narrow ? 190 : 250;
    const eventsTop = this.bottomEdge + 8;
    const axisTop = eventsTop + 12 * this.events.length;
    const height = axisTop + 22;
    this.end = Math.max(1, steps.at(-1)?.step ?? 1);

    const picture = svg("svg", { viewBox: `0 0 ${this.width} ${height}`, height, role: "img", "aria-label": this.describe() });
    for (const value of this.plot.ticks) {
      const y = this.y(value);
      picture.append(svg("line", { class: "grid", x1: this.left, x2: this.width - this.right, y1: y, y2: y }));
      picture.append(svg("text", { x: this.left - 8, y: y + 4, "text-anchor": "end" }, this.plot.tick(value)));
    }
    const stride = [1, 2, 5, 10, 20, 25, 50, 100, 200, 500, 1000].find((size) => this.end / size <= (narrow ? 6 : 12)) ?? this.end;
    for (let step = 0; step <= this.end; step += stride)
      picture.append(svg("text", { x: this.x(step), y: axisTop + 16, "text-anchor": "middle" }, String(step)));
    picture.append(svg("text", { x: this.left - 16, y: axisTop + 16, "text-anchor": "end" }, "step"));

    this.plot.series.toReversed().forEach(({ name, of }) => {
      const points = steps.filter((step) => known(of(step))).map((step) => [this.x(step.step).toFixed(1), this.y(of(step)).toFixed(1)]);
      if (name === "instances" && points.length > 1) {
        const floor = this.y(0);
        picture.append(svg("path", { class: "under", d: `M${points[0][0]},${floor}L${points.map(String).join("L")}L${points.at(-1)[0]},${floor}Z` }));
      }
      picture.append(svg("polyline", { class: `curve ${name}`, points: points.map(String).join(" ") }));
    });
    if (summary && this.plot.top === 1) this.drawMarks(picture, summary);
    this.events.forEach(({ name, steps: when }, row) => {
      for (const { step } of when)
        picture.append(svg("rect", { class: `event-${name}`, x: this.x(step) - 2, y: eventsTop + 12 * row, width: 4, height: 9, rx: 1.5 }));
    });

    this.now = svg("line", { class: "now", y1: this.topEdge - 4, y2: axisTop });
    this.dot = svg("circle", { class: "now-dot", r: 5 });
    picture.append(this.now, this.dot);
    this.holder.replaceChildren(picture);
    this.show(this.index);
  }

  drawMarks(picture, summary) {
    const goal = this.y(0.9826);
    picture.append(svg("line", { class: "goal", x1: this.left, x2: this.width - this.right, y1: goal, y2: goal }));
    const marks = [["90", summary.t90], ["95", summary.t95], ["98.26", summary.t98], ["100", summary.t100]];
    const labels = [];
    for (const [name, step] of marks) {
      const reached = this.run.steps.find((candidate) => candidate.step === step)?.coverage?.instances;
      if (!known(reached)) continue;
      const x = this.x(step);
      picture.append(svg("line", { class: "mark", x1: x, x2: x, y1: this.y(reached), y2: this.bottomEdge }));
      picture.append(svg("circle", { class: "dot", cx: x, cy: this.y(reached), r: 3.5 }, svg("title", {}, `${name} % after ${step} steps`)));
      // Marks whose labels would touch share one.
      let label = { start: x, end: x, names: [name] };
      while (labels.length && this.labelBox(labels.at(-1)).right + 8 > this.labelBox(label).left) {
        const before = labels.pop();
        label = { start: before.start, end: label.end, names: [...before.names, ...label.names] };
      }
      labels.push(label);
    }
    for (const label of labels) {
      const { text, middle } = this.labelBox(label);
      picture.append(svg("text", { class: "name", x: middle, y: this.topEdge - 11, "text-anchor": "middle" }, text));
    }
    if (!known(summary.t_stop)) return;
    const x = this.x(summary.t_stop);
    const y = this.bottomEdge;
    picture.append(svg("path", { class: "stop", d: `M${x},${y}v-22h-15l4,5.5l-4,5.5h15` }, svg("title", {}, `Stopped by itself at step ${summary.t_stop}`)));
    picture.append(svg("text", { class: "name", x: x - 20, y: y - 12, "text-anchor": "end" }, "stopped by itself"));
  }

  // A label in the middle over its marks, as wide as its text is about, inside the chart.
  labelBox({ start, end, names }) {
    const text = `${names.join(", ")} %`;
    const half = 3.8 * text.length;
    const middle = Math.min(Math.max((start + end) / 2, this.left + half), this.width - this.right - half);
    return { text, middle, left: middle - half, right: middle + half };
  }

  describe() {
    const last = this.run.steps.at(-1);
    const ends = this.plot.series.map(({ title, of }) => (last && known(of(last)) ? `${title} ${this.plot.say(of(last))}` : title));
    return `Curve over ${this.end} steps. At the end: ${ends.join(", ")}.`;
  }

  show(index) {
    this.index = index;
    const step = this.run.steps[index];
    if (!step) return;
    for (const { node, of } of this.values) node.textContent = known(of(step)) ? this.plot.say(of(step)) : "–";
    const x = this.x(step.step);
    this.now.setAttribute("x1", x);
    this.now.setAttribute("x2", x);
    const value = this.plot.series[0].of(step);
    this.dot.setAttribute("visibility", known(value) ? "visible" : "hidden");
    this.dot.setAttribute("cx", x);
    if (known(value)) this.dot.setAttribute("cy", this.y(value));
  }
}
