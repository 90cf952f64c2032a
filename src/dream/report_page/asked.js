// What a model was shown, asked and answered. All of it is text from a stranger, and shown as text.

const count = (number) => Math.round(number).toLocaleString("en");
const dollars = (cost) => (known(cost) ? `US$ ${cost.toFixed(cost < 0.1 ? 4 : 2)}` : "price unknown");
const minutes = (seconds) => (seconds < 90 ? `${count(seconds)} s` : `${(seconds / 60).toFixed(1)} min`);
const isWireTest = (config) => /^wire(:|$)/.test(config.planner_parameters?.model ?? "");

// Totals of the mission; of a run without a summary, what its lines say.
function askedInAll({ summary, steps }) {
  if (summary?.vlm) return summary.vlm;
  const asked = steps.filter((step) => step.asked);
  if (asked.length === 0) return null;
  const sum = (of) => asked.reduce((total, step) => total + of(step), 0);
  return { calls: sum((step) => step.asked.requests), fallbacks: sum((step) => (step.asked.fallback ? 1 : 0)), waited_s: sum((step) => step.waited_s) };
}

function reasons(vlm) {
  const each = Object.entries(vlm.reasons ?? {}).map(([reason, times]) => `${reason} ${times}`);
  return each.length ? ` (${each.join(", ")})` : "";
}

const outcomes = (vlm) => Object.entries(vlm.outcomes ?? {}).map(([outcome, times]) => `${times} ${outcome}`).join(", ");

// Whose word counted.
function decided(vlm) {
  const by = known(vlm.questions) && vlm.fallbacks > 0 ? `${vlm.fallbacks} of ${plural(vlm.questions, "question")} decided by geometry` : plural(vlm.fallbacks, "fallback");
  const answers = outcomes(vlm);
  return `${by}${reasons(vlm)}${answers ? `, its answers: ${answers}` : ""}`;
}

// The badge of an exchange, and what it says beside it.
function verdictOf({ fallback, outcome }) {
  if (fallback !== "") return ["warn", "No reply used", `${fallback}. The offline planner decided.`];
  if (!outcome) return ["good", "Reply used", ""];
  const [kind, ...why] = outcome.split(": ");
  const heeded = kind === "followed" || kind.startsWith("as ");
  return [heeded ? "good" : "warn", kind.charAt(0).toUpperCase() + kind.slice(1), why.length ? `${why.join(": ")}.` : ""];
}

// A mission under a model's name in which only the offline planner decided.
const withoutAnswer = (vlm) => known(vlm?.questions) && vlm.questions > 0 && vlm.fallbacks === vlm.questions;

function notAsked({ config, summary }) {
  const { model, model_name: name } = config.planner_parameters ?? {};
  if (!model || !summary || summary.ended === "aborted") return "";
  return `${name ? `${name} at ${model}` : model} was asked nothing${config.planner === "ranked" ? ": no choice was close enough" : ""}`;
}

function askedSentence(run) {
  const vlm = askedInAll(run);
  if (!vlm) return notAsked(run);
  const spent = known(vlm.tokens) ? `, ${count(vlm.tokens)} tokens, ${dollars(vlm.cost_usd)}` : "";
  const total = known(run.summary?.mission_s) ? ` of ${minutes(run.summary.mission_s)}` : "";
  const wire = isWireTest(run.config) ? ". A wire test: the stand-in answers by rule, which shows that the wire works, never what a model can do." : "";
  const { replay_replies: kept, record } = run.config.planner_parameters ?? {};
  const done = kept && !record ? "replayed, not asked" : "asked";
  return `${vlm.model ? `${vlm.model} was` : "A model was"} ${done}: ${plural(vlm.calls, "call")}${spent}, ${decided(vlm)}, waited ${minutes(vlm.waited_s)}${total}${wire}`;
}

// JSON is laid out; whatever else a model wrote stays as it came.
function laidOut(reply) {
  try {
    return JSON.stringify(JSON.parse(reply), null, 2);
  } catch {
    return reply;
  }
}

class Asked {
  // `exchangesOf` a step number gives, perhaps later, what a model was asked then and answered.
  constructor(panel, steps, exchangesOf) {
    this.panel = panel;
    this.steps = steps;
    this.exchangesOf = exchangesOf;
    this.wanted = null;
    this.large = null;
    this.questionOpen = false;
  }

  async show(step) {
    this.wanted = step;
    const exchanges = step.asked ? await this.exchangesOf(step.step) : [];
    if (this.wanted !== step) return;
    this.panel.replaceChildren(...exchanges.map((exchange, index) => this.exchange(exchange, index, exchanges.length, step)));
    if (exchanges.length > 0) return;
    const none = step.asked ? "What was asked at this step is not in the run's folder." : "No model was asked at this step.";
    this.panel.append(element("p", { className: "none" }, none, ...this.others(step.step)));
  }

  // Links to the nearest steps that were asked for.
  others(here) {
    const before = this.steps.findLast(({ asked, step }) => asked && step < here);
    const after = this.steps.find(({ asked, step }) => asked && step > here);
    return [["before", before], ["next", after]]
      .filter(([, found]) => found)
      .flatMap(([word, { step }]) => [` The one ${word}: `, element("a", { href: `#step=${step}`, textContent: `step ${step}` }), "."]);
  }

  exchange(exchange, index, total, step) {
    const [tone, badge, why] = verdictOf(exchange);
    const verdict = element("strong", { className: `badge ${tone}`, textContent: badge });
    const facts = [
      ["Model", exchange.answered_by ? `${exchange.model}, answered by ${exchange.answered_by}` : exchange.model],
      ["Prompt", exchange.prompt],
      ["Requests", exchange.requests === 1 ? "1" : `${exchange.requests}, asked again where the reply did not fit`],
      ["Tokens", `${count(exchange.tokens_in)} in, ${count(exchange.tokens_out)} out`],
      ["Cost", dollars(exchange.cost_usd)],
      ["Time", `${exchange.seconds.toFixed(1)} s on the wall${index === total - 1 && step.waited_s > 0 ? `, ${minutes(step.waited_s)} on the mission's clock` : ""}`],
    ];
    const list = element("dl", { className: "facts" });
    for (const [name, value] of facts) list.append(element("dt", { textContent: name }), element("dd", { textContent: value }));
    const said = element("div", { className: "said" }, element("p", { className: "verdict" }, verdict, " ", why), list);
    exchange.replies.forEach((reply, number) => {
      const counted = number === exchange.replies.length - 1;
      const title = exchange.replies.length === 1 ? "Reply" : counted ? "Last reply" : `Reply ${number + 1}, which did not fit`;
      said.append(element("h3", { textContent: title }));
      if (exchange.lacks?.[number]) said.append(element("p", { className: "lacks", textContent: `Lacks: ${exchange.lacks[number]}.` }));
      said.append(element("pre", { textContent: laidOut(reply) || "(empty)", tabIndex: 0 }));
    });
    if (exchange.replies.length === 0) said.append(element("p", { className: "none", textContent: "Nothing came back." }));
    const shown = element("div", { className: "shown" }, ...Object.entries(exchange.pictures).map(([name, source]) => this.picture(name, source)));
    const question = element("details", { open: this.questionOpen }, element("summary", { textContent: `The question in full, ${count(exchange.question.length)} characters` }), element("pre", { textContent: exchange.question, tabIndex: 0 }));
    question.addEventListener("toggle", () => (this.questionOpen = question.open));
    const expected = exchange.expected ? [element("details", {}, element("summary", { textContent: "What a reply must be: its JSON schema" }), element("pre", { textContent: exchange.expected, tabIndex: 0 }))] : [];
    const title = total > 1 ? [element("h3", { className: "which", textContent: `Question ${index + 1} of ${total}` })] : [];
    return element("article", { className: "exchange" }, ...title, shown, said, question, ...expected);
  }

  // A press shows it over the whole width.
  picture(name, source) {
    const figure = element("figure");
    const caption = element("figcaption", {}, element("span", { textContent: `[${name}]` }));
    if (source === null) {
      figure.append(element("div", { className: "picture missing" }), caption);
      return figure;
    }
    const image = element("img", { alt: `The picture ${name} that the model was shown`, src: source });
    image.addEventListener("load", () => caption.append(element("span", { textContent: `${image.naturalWidth} × ${image.naturalHeight}` })));
    const button = element("button", { type: "button", className: "enlarge", title: "Larger or smaller" }, image);
    const large = () => figure.classList.toggle("large", this.large === name);
    button.addEventListener("click", () => {
      this.large = this.large === name ? null : name;
      for (const other of this.panel.querySelectorAll("figure.large")) other.classList.remove("large");
      large();
    });
    large();
    figure.append(button, caption);
    return figure;
  }
}
