/** The reward desk: the numbers of a training that goes on, on sliders and in fields. */

import { Course, Dial, Sender, Term, format } from "./dials.js";
import { readFile } from "./files.js";
import { Policy } from "./onnx.js";
import { add, find } from "./panel.js";
import { COMMAND, SPEED, prepare } from "./plots.js";
import { Simulation } from "./simulation.js";

/**
 * @typedef {object} State what the training says of itself
 * @property {"training" | "paused" | "compiling" | "ended"} state
 * @property {number} iteration
 * @property {number} steps
 * @property {number} total
 * @property {import("./dials.js").Entry[]} numbers
 * @property {{term: string, help: string}[]} available
 * @property {{iteration: number, steps: number, name: string, old: number | null, new: number}[]} changes
 * @property {boolean} can_undo
 */

const PACE = 10; // s, over which steps per second are counted
const EPISODE = 10; // s, after which the training's conditions are drawn anew
const DRAWING = 0.2; // s between pictures of the curves
const TELLING = 15; // s that a note stays
const GRAVITY = 9.81; // m/s^2
const CHANGE = "#1c6dd0";
/** metric, label, unit and color of the curves */
const CURVES = [
  ["train/speed", "speed", " m/s", SPEED],
  ["train/reward", "reward", "", COMMAND],
];

/** @param {State["changes"][number]} change */
function describeChange({ iteration, name, old, new: value }) {
  const before = old === null ? "added at" : `${format(old)} to`;
  return `iteration ${iteration}: ${name.replace(/^env\.(reward\.)?/, "")} ${before} ${format(value)}`;
}

/** The desk beside the picture. */
export class Desk {
  /** @param {import("./main.js").Page} page @param {string} html of the desk */
  constructor(page, html) {
    document.body.insertAdjacentHTML("beforeend", html);
    add(document.head, "link", { rel: "stylesheet", href: "desk.css" });
    this.page = page;
    this.send = (/** @type {any} */ message) => page.server?.send(message);
    /** @type {State | null} */
    this.state = null;
    this.sender = new Sender((name, value) => this.send({ type: "set", name, value }));
    /** @type {Map<string, Dial>} */
    this.dials = new Map();
    /** @type {Map<string, Term>} */
    this.terms = new Map();
    this.course = new Course(1600);
    /** @type {Record<string, number>} */
    this.shares = {};
    this.drawn = 0;
    this.asked = "";
    this.box = find("desk");
    this.strip = find("desk-strip");
    this.total = find("desk-total");
    this.choice = find("desk-add");
    this.listen();
    this.box.open = !matchMedia("(width < 700px), (pointer: coarse)").matches;
    find("desk-settings").append(find("controls"));
    find("panel").remove();
  }

  listen() {
    for (const type of ["pause", "stop", "undo", "compare", "flags", "save"]) {
      find(`desk-${type}`).addEventListener("click", () => this.act(type));
    }
    find("comparison-end").addEventListener("click", () => this.compare());
    this.box.addEventListener("toggle", () => this.draw());
    this.strip.addEventListener("pointermove", (/** @type {PointerEvent} */ { offsetX }) => {
      this.nameChange(offsetX);
    });
    this.total.addEventListener("change", () => {
      this.send({ type: "total", value: Math.round(this.total.valueAsNumber) });
    });
    this.choice.addEventListener("change", () => {
      this.send({ type: "add", term: this.choice.value });
      this.choice.value = "";
    });
    const conditions = find("desk-conditions");
    conditions.addEventListener("change", () => this.setConditions(conditions.checked));
  }

  /** @param {string} type that a button asks for */
  act(type) {
    if (type === "compare") this.compare();
    else if (type === "pause" && this.state?.state === "paused") this.send({ type: "go" });
    else if (type !== "stop" || confirm("End the training now?")) {
      this.asked = type;
      this.send(type === "save" ? { type, file: find("desk-file").value } : { type });
    }
  }

  /** @param {any} message of the training */
  hear(message) {
    if (message.type === "desk") this.show(message);
    else if (message.type === "iteration") this.addIteration(message);
    else if (message.type === "note") this.tell(message.text, message.error);
    else if (message.type === "text") this.showText(message);
  }

  /** @param {State} state */
  show(state) {
    const names = new Set(state.numbers.map(({ name }) => name));
    if ([...this.dials.keys()].some((name) => !names.has(name))) {
      for (const { box } of this.terms.values()) box.remove();
      this.terms.clear();
      this.dials.clear();
    }
    for (const entry of state.numbers) {
      this.dials.get(entry.name)?.show(entry);
      if (!this.dials.has(entry.name)) this.addNumber(entry);
    }
    const offered = state.available.map(({ term, help }) => new Option(`${term}: ${help}`, term));
    if (offered.length + 1 !== this.choice.length) {
      this.choice.replaceChildren(new Option("add a term ...", ""), ...offered);
    }
    this.state = state;
    find("desk-undo").disabled = !state.can_undo;
    find("desk-pause").textContent = state.state === "paused" ? "go" : "pause";
    if (document.activeElement !== this.total) this.total.value = String(state.total);
    const change = state.changes.at(-1);
    find("desk-change").textContent = change ? describeChange(change) : "no change so far";
    this.draw();
  }

  /** @param {import("./dials.js").Entry} entry */
  addNumber(entry) {
    const key = `${entry.group} ${entry.term}`;
    const term = this.terms.get(key) ?? new Term(find(`desk-${entry.group}`), entry);
    this.terms.set(key, term);
    this.dials.set(entry.name, new Dial(term.numbers, entry, this.sender));
  }

  /** @param {any} message with the figures of an iteration */
  addIteration({ iteration, steps, seconds, shares, row }) {
    if (!this.state) return;
    Object.assign(this.state, { iteration, steps });
    this.shares = shares;
    this.course.add(seconds, steps, { ...row, ...shares });
    if (performance.now() / 1000 - this.drawn > DRAWING) this.draw();
  }

  draw() {
    this.drawn = performance.now() / 1000;
    if (!this.state || !this.box.open) return;
    find("desk-state").textContent = this.describe(this.state);
    this.drawStrip(this.state);
    const largest = Math.max(...Object.values(this.shares).map(Math.abs), 1e-9);
    for (const term of this.terms.values()) {
      term.show(this.shares[term.name] ?? 0, largest, this.course);
    }
  }

  /** @param {State} state */
  describe({ state, iteration, steps, total }) {
    const { samples } = this.course;
    const last = samples.at(-1) ?? { time: 0, steps: 0 };
    const first = samples.find(({ time }) => time >= last.time - PACE) ?? last;
    const pace = (last.steps - first.steps) / (last.time - first.time || 1);
    const parts = [
      `${state}, iteration ${iteration}`,
      `${(steps / 1e6).toFixed(2)} of ${(total / 1e6).toFixed(2)} M steps`,
    ];
    if (state === "training" && pace > 0) {
      parts.push(`${Math.round(pace).toLocaleString("en")} steps/s`);
      const left = new Date((1000 * Math.max(total - steps, 0)) / pace);
      parts.push(`${left.toISOString().slice(11, 19)} left`);
    }
    return parts.join(" · ");
  }

  /** @param {State} state */
  drawStrip({ changes }) {
    const { context, width, height } = prepare(this.strip);
    const { samples } = this.course;
    if (samples.length < 2) return;
    const [first, last] = [samples[0].steps, samples[samples.length - 1].steps];
    this.marks = changes
      .filter(({ steps }) => steps >= first)
      .map((change) => ({ change, x: (width * (change.steps - first)) / (last - first) }));
    context.fillStyle = CHANGE;
    for (const { x } of this.marks) context.fillRect(x - 0.5, 18, 1, height);
    let left = 6;
    for (const [name, label, unit, color] of CURVES) {
      this.course.draw(context, name, [width, 24, height - 5], color);
      const text = `${label} ${samples.at(-1)?.values[name]?.toFixed(2)}${unit}`;
      context.fillStyle = color;
      context.fillText(text, left, 13);
      left += context.measureText(text).width + 12;
    }
  }

  /**
   * Name the change whose mark is nearest.
   * @param {number} x pixels of the page
   */
  nameChange(x) {
    const at = (x * this.strip.width) / 2 / this.strip.clientWidth;
    const near = this.marks?.findLast((mark) => Math.abs(mark.x - at) < 6);
    this.strip.title = near ? describeChange(near.change) : "";
  }

  /**
   * Show a line for a while.
   * @param {string} text
   * @param {boolean} [isError]
   */
  tell(text, isError = false) {
    const note = find("desk-note");
    Object.assign(note, { textContent: text, hidden: false, className: isError ? "error" : "" });
    clearTimeout(this.timer);
    this.timer = setTimeout(() => (note.hidden = true), 1000 * TELLING);
  }

  /** @param {{kind: string, text: string, file: string | null}} message */
  showText({ text, file }) {
    if (this.asked !== (file ? "save" : "flags")) return;
    this.asked = "";
    if (file) return this.tell(`saved as ${file}`);
    const copied = navigator.clipboard?.writeText(text) ?? Promise.reject(new Error());
    copied.then(
      () => this.tell(`copied: ${text}`),
      () => {
        Object.assign(find("desk-text"), { hidden: false, value: text });
        find("desk-text").select();
      },
    );
  }

  /** Drive with the policies before and after the last change side by side, or end that. */
  async compare() {
    const { page } = this;
    if (page.rival) return this.endComparison();
    if (!this.state?.can_undo) return this.tell("There is no change to compare yet", true);
    const [name] = page.dogs;
    try {
      const [before, after] = await Promise.all(
        ["before", "after"].map(
          async (time) => new Policy(await readFile(`desk/${time}.policy.json`)),
        ),
      );
      if (page.dog?.name !== name) await page.open(name, page.ground);
      if (page.dog?.remote) return this.tell("A policy that acts in Python is not compared", true);
      const simulation = /** @type {Simulation} */ (page.simulation);
      simulation.setPolicy(after);
      const rival = new Simulation(page.mujoco, { ...simulation.robot, policy: before });
      rival.tile = simulation.tile;
      page.setRival(rival);
      page.change(simulation.settings);
      page.act("reset", true);
      this.showSpeeds([0, 0]);
    } catch (error) {
      this.tell(/** @type {Error} */ (error).message, true);
    }
  }

  /** Take the second robot away, and drive with the newest policy again. */
  endComparison() {
    const { page } = this;
    page.setRival(null);
    if (page.newest) page.setPolicy(page.newest);
  }

  /**
   * Show the speeds of the robots that are compared, until that ends.
   * @param {number[]} means m/s, of the last second
   */
  showSpeeds(means) {
    const { robots, rival } = this.page;
    find("comparison").hidden = !rival;
    if (!rival) return;
    const speeds = means.map((mean, k) => mean + 0.2 * (robots[k].velocity[0] - mean));
    const [after, before] = speeds.map((speed) => `${speed.toFixed(1)} m/s`);
    find("comparison-speeds").textContent =
      `gray, before the change: ${before}; after it: ${after}`;
    setTimeout(() => this.showSpeeds(speeds), 200);
  }

  /**
   * Let the robot meet the training's conditions, drawn anew now and then, or none.
   * @param {boolean} isReal
   */
  setConditions(isReal) {
    clearInterval(this.drawing);
    if (!isReal) return this.page.act("defaults", true);
    this.drawConditions();
    this.drawing = setInterval(() => this.drawConditions(), 1000 * EPISODE);
  }

  drawConditions() {
    const { simulation } = this.page;
    if (!simulation) return;
    const ranges = this.state?.numbers.filter(({ group }) => group === "randomization") ?? [];
    const sample = (/** @type {string} */ name, /** @type {number} */ usual) => {
      const ends = ranges.filter(({ term }) => term === name).map(({ value }) => value);
      const [low, high] = [Math.min(...ends), Math.max(...ends)];
      return ends.length ? low + (high - low) * Math.random() : usual;
    };
    const mass = simulation.masses.reduce((sum, part) => sum + part);
    this.page.change({
      friction: sample("friction", simulation.defaults().friction),
      payload: mass * sample("trunk_mass", 0),
      strength: sample("strength", 1),
      latency: sample("latency", 0),
      noise: sample("noise", 0),
      pushes: Math.sqrt(GRAVITY * simulation.start[2]) * sample("push", 0),
    });
  }
}
