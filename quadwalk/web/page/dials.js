/** What the desk is made of: numbers on sliders and in fields, terms, and courses over steps. */

import { add } from "./panel.js";
import { INK, drawLine, prepare } from "./plots.js";

/**
 * @typedef {object} Entry a number of the training
 * @property {string} name
 * @property {string} term
 * @property {"reward" | "termination" | "command" | "randomization"} group
 * @property {string} label
 * @property {number} value
 * @property {number} start its value at the training's start
 * @property {number | null} low
 * @property {number | null} high
 * @property {string} unit
 * @property {string} help
 */

const REST = 250; // ms without a newer value, after which one is sent
const HOLD = 2000; // ms after a touch, in which a number is not overwritten
const RECENT = 180; // s, of the lines of shares
const DECADES = 4; // on each side of a slider
const OFF = 0.06; // share of a side about the middle that is 0

/**
 * Return the largest size on the slider of a number that starts with this value.
 * @param {number} start
 */
export function findTop(start) {
  return start ? 10 ** (Math.ceil(Math.log10(Math.abs(start))) + 1) : 10;
}

/**
 * Return a slider's value, to two digits; its sides are logarithmic, its middle is 0.
 * @param {number} position -1 to 1
 * @param {number} top
 */
export function toValue(position, top) {
  const share = (Math.abs(position) - OFF) / (1 - OFF);
  if (share <= 0) return 0;
  return Number((Math.sign(position) * top * 10 ** (DECADES * (share - 1))).toPrecision(2));
}

/**
 * Return the position, -1 to 1, of a value on a slider.
 * @param {number} value
 * @param {number} top
 */
export function toPosition(value, top) {
  if (!value) return 0;
  const share = 1 + Math.log10(Math.abs(value) / top) / DECADES;
  return Math.sign(value) * (OFF + (1 - OFF) * Math.min(Math.max(share, 0.001), 1));
}

/** Sends a number's value when no newer one has come for `REST` ms, so that a drag is one change. */
export class Sender {
  /** @param {(name: string, value: number) => void} send */
  constructor(send) {
    this.send = send;
    /** @type {Map<string, ReturnType<typeof setTimeout>>} */
    this.timers = new Map();
  }

  /** @param {string} name @param {number} value */
  set(name, value) {
    clearTimeout(this.timers.get(name));
    const timer = setTimeout(() => this.send(name, value), REST);
    this.timers.set(name, timer);
  }
}

/** The figures of a training's iterations, thinned so that there are never more than so many. */
export class Course {
  /** @param {number} most */
  constructor(most) {
    this.most = most;
    this.every = 1;
    this.count = 0;
    /** @type {{time: number, steps: number, values: Record<string, number>}[]} */
    this.samples = [];
  }

  /**
   * @param {number} time s of training
   * @param {number} steps
   * @param {Record<string, number>} values
   */
  add(time, steps, values) {
    while ((this.samples.at(-1)?.steps ?? -1) >= steps) this.samples.pop(); // after an undo
    if (this.count++ % this.every) return;
    this.samples.push({ time, steps, values });
    if (this.samples.length < this.most) return;
    this.samples = this.samples.filter((_, k) => k % 2 === 0);
    this.every *= 2;
  }

  /**
   * Draw a figure from the left to the right, between its least and its greatest value.
   * @param {CanvasRenderingContext2D} context
   * @param {string} name
   * @param {number[]} box width, top and bottom, pixels
   * @param {string} color
   * @param {number} [since] s, before which nothing is drawn
   */
  draw(context, name, [width, top, bottom], color, since = -Infinity) {
    const samples = this.samples.filter(
      ({ time, values }) => time >= since && typeof values[name] === "number",
    );
    if (samples.length < 2) return;
    const values = samples.map((sample) => sample.values[name]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const first = samples[0].steps;
    const length = samples[samples.length - 1].steps - first || 1;
    const points = samples.map(({ steps }, k) => [
      (width * (steps - first)) / length,
      bottom - ((bottom - top) * (values[k] - low)) / (high - low || 1),
    ]);
    drawLine(context, points, color);
  }
}

/**
 * Return a number as people write it.
 * @param {number} value
 */
export function format(value) {
  return String(Number.isInteger(value) ? value : Number(value.toPrecision(4)));
}

/** One number: a field, and a slider where it is a term's scale. */
export class Dial {
  /** @param {HTMLElement} place @param {Entry} entry @param {Sender} sender */
  constructor(place, entry, sender) {
    this.entry = entry;
    this.sender = sender;
    this.touched = -Infinity;
    this.top = findTop(entry.start);
    const isScale = entry.group === "reward" && entry.name.endsWith(".scale");
    const text = isScale ? "" : [entry.label, entry.unit].filter(Boolean).join(", ");
    this.line = add(place, "label", { textContent: text, title: entry.name });
    this.slider = isScale ? this.addSlider() : null;
    this.field = add(this.line, "input", { type: "number", step: "any" });
    this.field.setAttribute("aria-label", `${entry.term} ${entry.label}`);
    this.field.addEventListener("change", () => this.change(this.field.valueAsNumber));
    this.field.addEventListener("blur", () => this.show(this.entry));
    this.back = add(place, "button", { className: "back", type: "button" });
    this.back.addEventListener("click", () => this.change(this.entry.start));
    this.show(entry);
  }

  addSlider() {
    const slider = add(this.line, "input", { type: "range", min: "-1", max: "1", step: "0.005" });
    slider.setAttribute("aria-label", this.entry.term);
    slider.addEventListener("input", () => {
      const { low, high } = this.entry;
      const value = toValue(slider.valueAsNumber, this.top);
      this.change(Math.min(Math.max(value, low ?? -Infinity), high ?? Infinity));
    });
    slider.addEventListener("change", () => slider.blur());
    return slider;
  }

  /** @param {number} value that the user asks for */
  change(value) {
    if (Number.isNaN(value)) return;
    this.touched = performance.now();
    setTimeout(() => this.show(this.entry), HOLD + 50);
    this.showValue(value);
    this.sender.set(this.entry.name, value);
  }

  /** @param {Entry} entry as the training has it */
  show(entry) {
    this.entry = entry;
    const isChanged = entry.value !== entry.start;
    this.back.textContent = isChanged ? `start ${format(entry.start)}` : "";
    this.line.classList.toggle("changed", isChanged);
    if (performance.now() - this.touched > HOLD) this.showValue(entry.value);
  }

  /** @param {number} value shown where the user is not at work */
  showValue(value) {
    const { field, slider } = this;
    if (document.activeElement !== field) field.value = format(value);
    if (slider && !slider.matches(":active")) slider.value = `${toPosition(value, this.top)}`;
  }
}

/** One term: its numbers and help, and its share of the reward as a bar and a line. */
export class Term {
  /** @param {HTMLElement} place @param {Entry} entry */
  constructor(place, entry) {
    this.name = entry.term;
    this.box = add(place, "section");
    const title = add(this.box, "h3", { textContent: entry.term });
    if (entry.group === "reward") {
      this.bar = add(add(title, "span", { className: "share" }), "i");
      this.number = add(title, "output");
      this.line = add(title, "canvas", { width: 160, height: 44 });
    }
    const textContent = entry.help.replaceAll("`", "");
    const last = [...place.querySelectorAll("p")].at(-1)?.textContent;
    if (textContent && textContent !== last) add(this.box, "p", { textContent });
    this.numbers = add(this.box, "div", { className: "numbers" });
  }

  /**
   * Show the term's share of the reward.
   * @param {number} share
   * @param {number} largest size of all shares
   * @param {Course} course
   */
  show(share, largest, course) {
    if (!this.bar || !this.number || !this.line?.clientWidth) return;
    const width = (50 * Math.abs(share)) / largest;
    Object.assign(this.bar.style, { width: `${width}%`, left: `${share < 0 ? 50 - width : 50}%` });
    this.bar.classList.toggle("less", share < 0);
    this.number.value = share.toFixed(3);
    const { context, width: right, height } = prepare(this.line);
    const since = (course.samples.at(-1)?.time ?? 0) - RECENT;
    course.draw(context, this.name, [right, 2, height - 2], INK, since);
  }
}
