// Going through the steps of a run, with the mouse, the keyboard and the address.

// The number of the step that the address names; null where it names none.
function stepInAddress() {
  const found = /^#(?:.*&)?step=(\d{1,6})(?:&|$)/.exec(location.hash);
  return found ? Number(found[1]) : null;
}

class Player {
  // `show` is given the index of the step to show; `address` gives what follows the # for it.
  constructor(show, address = (step) => `step=${step.step}`) {
    Object.assign(this, { showStep: show, address, steps: [], travelled: [], current: 0, timer: 0, settle: 0 });
    at("play").addEventListener("click", () => this.toggle());
    at("first").addEventListener("click", () => this.seek(0));
    at("back").addEventListener("click", () => this.seek(this.current - 1));
    at("forward").addEventListener("click", () => this.seek(this.current + 1));
    at("last").addEventListener("click", () => this.seek(this.steps.length - 1));
    at("speed").addEventListener("change", () => this.timer && this.play());
    at("slider").addEventListener("input", () => this.seek(Number(at("slider").value)));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  // A run, or what it has become.
  open(steps) {
    if (steps !== this.steps) {
      this.pause();
      clearTimeout(this.settle);
      Object.assign(this, { steps, travelled: [], current: 0 });
    }
    steps.slice(this.travelled.length).forEach((step) => this.travelled.push((this.travelled.at(-1) ?? 0) + step.distance_m));
    at("slider").max = Math.max(0, steps.length - 1);
  }

  get atEnd() {
    return this.current === this.steps.length - 1;
  }

  show(index) {
    this.current = Math.max(0, Math.min(index, this.steps.length - 1));
    const step = this.steps[this.current];
    if (!step) return;
    this.showStep(this.current);
    document.dispatchEvent(new CustomEvent("step", { detail: step.step }));
    this.place();
    // Browsers limit how often an address may change, so it follows once the step has settled.
    clearTimeout(this.settle);
    const hash = `#${this.address(step, this.atEnd)}`;
    this.settle = setTimeout(() => history.replaceState(null, "", hash), 250);
  }

  // Where it is among the steps there are.
  place() {
    const { steps, current } = this;
    const step = steps[current];
    const slider = at("slider");
    slider.value = current;
    slider.style.setProperty("--fill", `${(100 * current) / Math.max(1, steps.length - 1)}%`);
    slider.setAttribute("aria-valuetext", `step ${step.step} of ${steps.at(-1).step}`);
    at("counter").replaceChildren(`Step ${step.step} `, element("small", {}, `of ${steps.at(-1).step}`, element("span", { className: "way", textContent: ` · ${metres(this.travelled[current], 0)}` })));
  }

  pause() {
    clearInterval(this.timer);
    this.timer = 0;
    at("play").setAttribute("aria-pressed", "false");
    at("play").setAttribute("aria-label", "Play");
  }

  play() {
    if (this.atEnd) this.show(0);
    clearInterval(this.timer);
    this.timer = setInterval(() => {
      this.show(this.current + 1);
      if (this.atEnd) this.pause();
    }, 1000 / Number(at("speed").value));
    at("play").setAttribute("aria-pressed", "true");
    at("play").setAttribute("aria-label", "Pause");
  }

  toggle() {
    if (this.timer) this.pause();
    else this.play();
  }

  seek(index) {
    this.pause();
    this.show(index);
  }

  key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey || event.target.closest("select, details, pre")) return;
    const jump = { ArrowLeft: this.current - 1, ArrowRight: this.current + 1, PageUp: this.current - 10, PageDown: this.current + 10, Home: 0, End: this.steps.length - 1 }[event.key];
    if (jump !== undefined) this.seek(jump);
    else if (event.key === " " && !event.target.closest("button, a")) this.toggle();
    else return;
    event.preventDefault();
  }
}
