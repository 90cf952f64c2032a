// A page on which a target is taught: strokes go to the server, and come back as labels of all pictures.

const { colors } = JSON.parse(document.body.dataset.fixed);
const RETRY_MS = 1500;
const MOST_ZOOM = 12;

const at = (id) => document.getElementById(id);
const area = at("area");
const stack = at("stack");
const canvas = at("now");

let view = null; // what the server told last
let current = 0; // the picture on the stage
let mark = "target";
let tool = "brush";
let line = null; // the stroke that is drawn now, as shares of the picture
let sent = []; // strokes that the marks' picture does not show yet
let posts = Promise.resolve(); // one after the other, in the order in which they were drawn
let zoom = 1;
let offset = [0, 0]; // of the zoomed picture, in pixels of the screen
let fit = [0, 0, 1, 1]; // left, top, width and height of the picture as it fits the stage
let moving = null;
let space = false;
const pointers = new Map();

const picture = () => view?.pictures[current];
const share = (value) => value.toFixed(2);
const plural = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

function element(kind, fields = {}, ...children) {
  const made = Object.assign(document.createElement(kind), fields);
  made.append(...children);
  return made;
}

function complain(text) {
  at("refused").textContent = text.trim();
  at("refused").hidden = !text;
}

async function post(path, body) {
  const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) }).catch(() => null);
  complain(answer?.ok ? "" : answer ? await answer.text() : "No connection: nothing was sent.");
  return Boolean(answer?.ok);
}

// ---- the stage

function layOut() {
  const size = picture()?.size;
  if (!size) return;
  const factor = Math.min(area.clientWidth / size[0], area.clientHeight / size[1]);
  const [width, height] = [size[0] * factor, size[1] * factor];
  fit = [(area.clientWidth - width) / 2, (area.clientHeight - height) / 2, width, height];
  stack.style.width = `${width}px`;
  stack.style.height = `${height}px`;
  const scale = Math.min(2, devicePixelRatio || 1);
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  place();
  paint();
}

function place() {
  const [left, top, width, height] = fit;
  // Half of the picture stays in view.
  offset[0] = Math.min(area.clientWidth / 2 - left, Math.max(area.clientWidth / 2 - left - width * zoom, offset[0]));
  offset[1] = Math.min(area.clientHeight / 2 - top, Math.max(area.clientHeight / 2 - top - height * zoom, offset[1]));
  if (zoom === 1) offset = [0, 0];
  stack.style.transform = `translate(${left + offset[0]}px, ${top + offset[1]}px) scale(${zoom})`;
}

function zoomed(by, x, y) {
  const next = Math.min(MOST_ZOOM, Math.max(1, zoom * by));
  const px = x - fit[0];
  const py = y - fit[1];
  offset = [px - ((px - offset[0]) * next) / zoom, py - ((py - offset[1]) * next) / zoom];
  zoom = next;
  place();
}

// Where on the picture a pointer is, as shares of its width and height.
function where(event) {
  const box = area.getBoundingClientRect();
  const x = (event.clientX - box.left - fit[0] - offset[0]) / (fit[2] * zoom);
  const y = (event.clientY - box.top - fit[1] - offset[1]) / (fit[3] * zoom);
  const kept = (value) => Math.min(1.5, Math.max(-0.5, value));
  return [kept(x), kept(y)];
}

const width = () => Number(at("width").value) / 1000;

function paintStroke(context, stroke) {
  const [w, h] = [canvas.width, canvas.height];
  const points = stroke.points.map(([x, y]) => [x * w, y * h]);
  const color = stroke.mark === "none" ? [210, 225, 232] : colors[stroke.mark];
  context.strokeStyle = context.fillStyle = `rgb(${color.join(" ")} / ${stroke.mark === "none" ? 0.45 : 0.75})`;
  if (stroke.tool === "box") {
    const [[x0, y0], [x1, y1]] = [points[0], points.at(-1)];
    context.fillRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
    return;
  }
  context.lineWidth = Math.max(1, stroke.width * w);
  context.lineCap = context.lineJoin = "round";
  context.beginPath();
  context.moveTo(...points[0]);
  for (const point of points.slice(points.length > 1 ? 1 : 0)) context.lineTo(...point);
  context.stroke();
}

function paint() {
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  for (const { stroke } of sent.filter((one) => one.stroke.picture === current)) paintStroke(context, stroke);
  if (line) paintStroke(context, line);
}

function begin(event) {
  area.focus({ preventScroll: true });
  pointers.set(event.pointerId, event);
  area.setPointerCapture(event.pointerId);
  if (space || event.button === 1 || pointers.size > 1) {
    line = null;
    paint();
    moving = [event.clientX, event.clientY];
    event.preventDefault();
    return;
  }
  if (event.button !== 0 || !picture()?.open) return;
  line = { picture: current, tool, mark, width: width() / zoom, points: [where(event)] };
  paint();
}

function go(event) {
  pointers.set(event.pointerId, event);
  if (moving) {
    offset = [offset[0] + event.clientX - moving[0], offset[1] + event.clientY - moving[1]];
    moving = [event.clientX, event.clientY];
    place();
  } else if (line) {
    const point = where(event);
    if (line.tool === "box") line.points = [line.points[0], point];
    else if (line.points.length < 4000) line.points.push(point);
    paint();
  }
}

function end(event) {
  pointers.delete(event.pointerId);
  moving = null;
  if (!line) return;
  const stroke = line;
  line = null;
  const one = { stroke, done: false };
  sent.push(one);
  paint();
  posts = posts.then(async () => {
    one.done = await post("/draw", stroke);
    if (!one.done) sent = sent.filter((other) => other !== one);
    else if (stroke.picture === current) delete asked.marks; // What is there may be from before.
    else sent = sent.filter((other) => other !== one);
    paint();
    show();
  });
}

// ---- what is shown

let staged = -1; // the picture that the stage is laid out for
const asked = {}; // what each picture element shows, so that nothing is fetched twice

// An overlay stays until the next one is there.
function source(image, url, done = () => {}) {
  if (asked[image.id] === url) return;
  asked[image.id] = url;
  const next = new Image();
  next.onload = () => {
    if (asked[image.id] !== url) return;
    image.src = url;
    image.decode().then(() => { image.hidden = false; done(); }, () => {});
  };
  next.onerror = () => { if (asked[image.id] === url) delete asked[image.id]; };
  next.src = url;
}

function showStage() {
  const one = picture();
  const open = Boolean(one?.open);
  stack.hidden = !open;
  at("wait").hidden = open;
  at("wait").textContent = one?.lost || "opening";
  at("name").textContent = one?.name ?? "–";
  const told = one?.iou != null ? `left out, it is told with IoU ${share(one.iou)} over its marks` : one?.wrong != null ? `left out, ${Math.round(100 * one.wrong)} % of its marks are told wrongly` : "";
  at("told").textContent = told;
  at("back").disabled = !one?.back;
  at("clear").disabled = !(one?.target || one?.other);
  if (!open) {
    fetch(`/pictures/${current}/shown`).catch(() => {}); // It is opened before the others.
    return;
  }
  if (staged !== current) {
    staged = current;
    for (const id of ["labels", "marks"]) { at(id).hidden = true; delete asked[id]; }
    at("shown").src = `/pictures/${current}/shown`;
    [zoom, offset] = [1, [0, 0]];
    layOut();
  }
  if (one.target || one.other || one.turns) {
    const shows = sent.filter((other) => other.done);
    source(at("marks"), `/pictures/${current}/marks?v=${one.turns}`, () => {
      at("marks").hidden = !pressed("show-marks");
      sent = sent.filter((other) => !shows.includes(other));
      paint();
    });
  }
  if (!one.labelled) at("labels").hidden = true;
  else source(at("labels"), `/pictures/${current}/labels?v=${view.heads}`, () => (at("labels").hidden = !pressed("show-labels")));
}

function makeThumbs() {
  at("thumbs").replaceChildren(...view.pictures.map((one, n) => {
    const frame = element("span", { className: "frame" });
    const who = element("span", { className: "who" }, element("span", { textContent: one.name, title: one.name }));
    const button = element("button", { type: "button", onclick: () => choose(n) }, frame, who);
    return element("li", {}, button);
  }));
}

function showThumbs() {
  const items = [...at("thumbs").children];
  const unsure = view.pictures.map((one) => (one.open && !one.target && !one.other && one.unsure != null ? one.unsure : -1));
  const next = Math.max(...unsure) > 0.02 ? unsure.indexOf(Math.max(...unsure)) : -1;
  view.pictures.forEach((one, n) => {
    const button = items[n].firstChild;
    const [frame, who] = button.children;
    button.setAttribute("aria-current", String(n === current));
    const [plain, over] = [frame.querySelector(".plain"), frame.querySelector(".over")];
    if (one.lost && !frame.querySelector(".lost")) frame.append(element("span", { className: "lost", textContent: "cannot be read", title: one.lost }));
    if (one.open && !plain) frame.prepend(element("img", { className: "plain", alt: "", loading: "lazy", src: `/pictures/${n}/thumb` }));
    if (one.labelled && pressed("show-labels")) {
      const url = `/pictures/${n}/small?v=${view.heads}`;
      const image = over ?? element("img", { className: "over", alt: "", loading: "lazy" });
      if (image.getAttribute("src") !== url) image.src = url;
      if (!over) frame.append(image);
    } else over?.remove();
    frame.querySelector(".tag")?.remove();
    if (one.iou != null) frame.append(element("span", { className: "tag", textContent: `IoU ${share(one.iou)}`, title: "As all other marked pictures tell it" }));
    else if (one.wrong != null) frame.append(element("span", { className: "tag", textContent: `${Math.round(100 * one.wrong)} % wrong`, title: "Of its marks, as all other marked pictures tell it" }));
    else if (n === next) frame.append(element("span", { className: "tag next", textContent: "mark next", title: "Of this picture it is least sure" }));
    who.replaceChildren(who.firstChild, ...["target", "other"].filter((kind) => one[kind]).map((kind) => element("span", { className: `dot ${kind}`, title: `${kind} is marked` })));
  });
  const marked = view.pictures.filter((one) => one.target || one.other).length;
  at("count").textContent = `${marked} of ${view.pictures.length} marked`;
}

function showState() {
  const busy = /^(learning|measuring|opening)/.exec(view.doing)?.[1];
  const word = view.lacks ? "mark" : busy ?? "ready";
  at("state").textContent = word;
  at("state").className = `badge ${word === "ready" ? "good" : word === "mark" ? "" : "warn"}`;
  at("say").textContent = view.lacks ? `Next: ${view.lacks.replace("target", view.target).replace("other", `of what is not ${view.target}`)}, with a few strokes.` : view.doing || (view.seconds ? `learned and measured in ${view.seconds.toFixed(1)} s` : "");
  at("save").disabled = Boolean(view.lacks);
  const { quality } = view;
  const figure = at("figure");
  const meaning = at("meaning");
  if (quality?.iou != null) {
    figure.textContent = `IoU ${share(quality.iou)} [${share(quality.low)}, ${share(quality.high)}]`;
    meaning.textContent = "each marked picture told by the others alone, over its marks; 95 % interval by Student's t. Marks are no full masks: on whole pictures it may differ.";
  } else {
    figure.textContent = view.lacks || !quality ? "–" : "not measured";
    meaning.textContent = view.lacks ? "how good it is will stand here" : quality ? `${quality.why}.` : "being measured anew";
  }
  at("saved").hidden = !view.saved;
  at("line").textContent = view.saved ? `dream dive --labels ${view.saved}` : "";
}

function show() {
  if (at("thumbs").children.length !== view.pictures.length) makeThumbs();
  showState();
  showStage();
  showThumbs();
}

// ---- what is pressed

const pressed = (id) => at(id).getAttribute("aria-pressed") === "true";

function choose(n) {
  current = Math.min(view.pictures.length - 1, Math.max(0, n));
  show();
  at("thumbs").children[current].scrollIntoView({ block: "nearest", inline: "nearest" });
}

function press(kind, value) {
  if (kind === "mark") mark = value;
  else tool = value;
  for (const button of document.querySelectorAll(`[data-${kind}]`)) button.setAttribute("aria-pressed", String(button.dataset[kind] === value));
}

function toggle(id, images) {
  at(id).setAttribute("aria-pressed", String(!pressed(id)));
  for (const image of images) at(image).hidden = !pressed(id) || !at(image).getAttribute("src");
  if (view) show();
}

const undo = () => (posts = posts.then(() => post("/back", { picture: current })));
const wider = (by) => (at("width").value = String(Number(at("width").value) * by));

async function save() {
  at("save").disabled = true;
  at("save").textContent = "Saving …";
  await post("/save", {});
  at("save").textContent = "Save model";
  at("save").disabled = Boolean(view.lacks);
}

for (const button of document.querySelectorAll("[data-mark]")) button.onclick = () => press("mark", button.dataset.mark);
for (const button of document.querySelectorAll("[data-tool]")) button.onclick = () => press("tool", button.dataset.tool);
at("show-labels").onclick = () => toggle("show-labels", ["labels"]);
at("show-marks").onclick = () => toggle("show-marks", ["marks"]);
at("back").onclick = undo;
at("clear").onclick = () => (posts = posts.then(() => post("/clear", { picture: current })));
at("save").onclick = save;

const KEYS = {
  t: () => press("mark", "target"), n: () => press("mark", "other"), e: () => press("mark", "none"),
  b: () => press("tool", "brush"), x: () => press("tool", "box"), z: undo,
  l: () => toggle("show-labels", ["labels"]), m: () => toggle("show-marks", ["marks"]),
  arrowright: () => choose(current + 1), arrowleft: () => choose(current - 1),
  "[": () => wider(0.8), "]": () => wider(1.25),
  0: () => { [zoom, offset] = [1, [0, 0]]; place(); },
};

document.addEventListener("keydown", (event) => {
  if (event.key === " " && !(event.target instanceof HTMLButtonElement)) {
    space = true;
    area.classList.add("moving");
    event.preventDefault();
    return;
  }
  const undoes = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z";
  if (!view || event.altKey || ((event.ctrlKey || event.metaKey) && !undoes)) return;
  const act = KEYS[event.key.toLowerCase()];
  const slides = event.target.id === "width" && event.key.startsWith("Arrow");
  if (!act || slides) return;
  event.preventDefault();
  act();
});
document.addEventListener("keyup", (event) => {
  if (event.key !== " ") return;
  space = false;
  area.classList.remove("moving");
});

area.addEventListener("pointerdown", begin);
area.addEventListener("pointermove", go);
area.addEventListener("pointerup", end);
area.addEventListener("pointercancel", (event) => { line = null; end(event); paint(); });
area.addEventListener("wheel", (event) => {
  event.preventDefault();
  const box = area.getBoundingClientRect();
  zoomed(Math.exp(-event.deltaY / 400), event.clientX - box.left, event.clientY - box.top);
}, { passive: false });
new ResizeObserver(layOut).observe(area);

// ---- what the server tells

async function listen() {
  let lost = false;
  for (;;) {
    const answer = await fetch(`/view?has=${view?.number ?? ""}`).catch(() => null);
    if (answer?.status === 200) view = await answer.json();
    if (answer?.status === 200 || (answer?.status === 204 && lost)) {
      lost = false;
      show();
    } else if (answer?.status !== 204) {
      lost = true;
      at("state").textContent = answer ? "refused" : "no connection";
      at("state").className = "badge bad";
      at("say").textContent = answer ? await answer.text() : "Marks are kept; start dream teach again.";
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}

listen();
