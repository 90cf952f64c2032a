// Pictures are decoded when they are shown, never all at once. Depth and labels arrive as one level per pixel.

const SHOWN = ["map", "rgb", "depth", "labels"];

// Near is bright and far is dark, as under water.
const DEPTH_STOPS = [[253, 231, 170], [246, 176, 98], [222, 110, 92], [160, 62, 108], [92, 44, 112], [38, 32, 82], [10, 16, 38]];
const NO_DEPTH = [120, 134, 142];

function depthColor(share) {
  const place = Math.min(Math.max(share, 0), 1) * (DEPTH_STOPS.length - 1);
  const index = Math.min(Math.floor(place), DEPTH_STOPS.length - 2);
  return DEPTH_STOPS[index].map((from, channel) => from + (place - index) * (DEPTH_STOPS[index + 1][channel] - from));
}

const whole = (image) => ({ left: 0, top: 0, width: image.naturalWidth, height: image.naturalHeight });

// The colour of every level of 256, as a pixel of a canvas is laid in memory: a whole one is set at once.
function table(colorOf) {
  const bytes = Uint8ClampedArray.from(Array.from({ length: 256 }, (_, level) => [...colorOf(level), 255]).flat());
  return new Uint32Array(bytes.buffer);
}

class Pictures {
  // `sourcesOf` a step number gives the address of each picture; `deeper` is called where a scale grows.
  constructor(run, sourcesOf, deeper = () => {}) {
    this.run = run;
    this.sourcesOf = sourcesOf;
    this.deeper = deeper;
    this.canvases = Object.fromEntries(SHOWN.map((name) => [name, document.getElementById(name)]));
    this.tables = { depth: this.depthTable(), labels: table((level) => run.labels[level]?.color ?? [255, 0, 255]) };
    this.levels = {};
    this.wanted = null;
    this.decoded = new Map();
  }

  depthTable() {
    return table((level) => (level === 0 ? NO_DEPTH : depthColor((level * this.run.depth_level) / this.run.depth_max)));
  }

  // The images of a step; null where there is none, or none that can be decoded.
  load(step) {
    if (!this.decoded.has(step)) {
      const sources = this.sourcesOf(step);
      const images = SHOWN.map(async (name) => {
        if (!sources[name]) return null;
        const image = new Image();
        image.src = sources[name];
        return image.decode().then(() => image, () => null);
      });
      this.decoded.set(step, Promise.all(images));
      if (this.decoded.size > 8) this.decoded.delete(this.decoded.keys().next().value);
    }
    return this.decoded.get(step);
  }

  async show(step, next) {
    this.wanted = step;
    const images = await this.load(step);
    if (this.wanted !== step) return;
    SHOWN.forEach((name, index) => this.draw(name, images[index]));
    if (next !== undefined) this.load(next);
  }

  draw(name, image) {
    const canvas = this.canvases[name];
    canvas.parentElement.classList.toggle("missing", image === null);
    delete this.levels[name];
    if (image === null) return;
    const { left, top, width, height } = name === "map" ? this.mapOn(image) : whole(image);
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
      canvas.parentElement.style.aspectRatio = `${width} / ${height}`;
    }
    const context = canvas.getContext("2d", { willReadFrequently: name in this.tables });
    context.drawImage(image, -left, -top);
    if (!(name in this.tables)) return;
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
    const colored = new Uint32Array(pixels.data.buffer);
    const levels = new Uint8Array(colored.length);
    for (let pixel = 0; pixel < levels.length; pixel++) levels[pixel] = pixels.data[4 * pixel];
    if (name === "depth") this.reach(levels.reduce((most, level) => Math.max(most, level), 0));
    const colors = this.tables[name];
    for (let pixel = 0; pixel < levels.length; pixel++) colored[pixel] = colors[levels[pixel]];
    context.putImageData(pixels, 0, 0);
    this.levels[name] = { levels, width: canvas.width, height: canvas.height };
  }

  // The map itself, without the axes and the legend of its picture, which the page writes; all of a picture that is
  // not as large as it should be, as of an older run.
  mapOn(image) {
    const { inset } = this.run;
    const fits = known(inset) && inset.picture[0] === image.naturalWidth && inset.picture[1] === image.naturalHeight;
    document.getElementById("sheet").classList.toggle("whole", !fits);
    return fits ? inset : whole(image);
  }

  // The scale ends at the next five metres beyond the farthest ground that was shown.
  reach(level) {
    const farthest = 5 * Math.ceil((level * this.run.depth_level) / 5);
    if (farthest <= this.run.depth_max) return;
    this.run.depth_max = farthest;
    this.tables.depth = this.depthTable();
    this.deeper();
  }

  // What lies under a point of the image, given in shares of its width and height.
  probe(across, down) {
    const level = (name) => {
      const image = this.levels[name];
      if (!image) return null;
      const column = Math.min(Math.floor(across * image.width), image.width - 1);
      const row = Math.min(Math.floor(down * image.height), image.height - 1);
      return image.levels[row * image.width + column];
    };
    const depth = level("depth");
    const label = level("labels");
    const words = [];
    if (depth !== null) words.push(depth === 0 ? "no depth" : metres(depth * this.run.depth_level));
    if (label !== null) words.push(this.run.labels[label]?.name ?? "unknown label");
    return words.join(" · ");
  }

  // Share of the picture that each label takes; null where there is no picture.
  shares() {
    const image = this.levels.labels;
    if (!image) return null;
    const counts = new Array(256).fill(0);
    for (const level of image.levels) counts[level]++;
    return this.run.labels.map((_, label) => counts[label] / image.levels.length);
  }

  drawDepthScale(canvas) {
    const context = canvas.getContext("2d");
    for (let column = 0; column < canvas.width; column++) {
      context.fillStyle = `rgb(${depthColor(column / (canvas.width - 1)).map(Math.round).join(" ")})`;
      context.fillRect(column, 0, 1, 1);
    }
  }
}
