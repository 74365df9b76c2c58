/** The controls beside the picture. */

/** @typedef {import("./simulation.js").Settings} Settings */
/** @typedef {{input: HTMLInputElement, output: HTMLOutputElement}} Slider */

/** @type {[keyof Settings, string, number, number, number][]} name, label, least, most, step */
const SLIDERS = [
  ["friction", "friction of the floor", 0.1, 1.5, 0.05],
  ["payload", "payload, kg", 0, 15, 0.5],
  ["strength", "strength of the motors", 0.5, 1.2, 0.05],
  ["latency", "latency, s", 0, 0.06, 0.002],
  ["noise", "noise of the sensors", 0, 3, 0.1],
  ["pushes", "pushes, m/s", 0, 2, 0.1],
];
const PACES = ["0.1", "0.25", "0.5", "1", "2", "4"];

/**
 * Return an element of the page; what it can is for the caller to say.
 * @param {string} id
 * @returns {any}
 */
export function find(id) {
  return document.getElementById(id);
}

/**
 * Make an element with a parent.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {HTMLElement} parent
 * @param {T} tag
 * @param {Record<string, any>} [properties]
 * @returns {HTMLElementTagNameMap[T]}
 */
export function add(parent, tag, properties = {}) {
  const element = Object.assign(document.createElement(tag), properties);
  parent.append(element);
  return element;
}

/** Makes the controls, and tells what is asked of them. */
export class Panel {
  /** @param {HTMLElement} place @param {(name: string, value: any) => void} ask */
  constructor(place, ask) {
    /** @type {HTMLElement} */
    this.place = place;
    this.ask = ask;
    /** @type {Map<string, Slider>} */
    this.sliders = new Map();
    this.dogs = this.addChoice("dog", "policy", []);
    this.checkpoints = this.addChoice("checkpoint", "checkpoint", []);
    this.grounds = this.addChoice("ground", "ground", []);
    this.pace = this.addChoice("pace", "pace of time", PACES, "1");
    this.addChoice("release", "when all keys are released", ["stand", "walk"], "stand");
    for (const slider of SLIDERS) this.addSlider(slider);
    this.addButtons({
      kick: "kick (K)",
      throw: "throw (T)",
      reset: "reset (R)",
      pause: "pause (P)",
    });
    this.addButtons({ camera: "camera (C)", defaults: "defaults", link: "copy link" });
    this.films = this.addButtons({ film: "save the last 10 s" });
    this.addToggle("forces", "forces on the feet");
    this.addToggle("trail", "trail");
    this.addToggle("plots", "plots");
  }

  /**
   * @param {string} name
   * @param {string} label
   * @param {string[]} options
   * @param {string} [value]
   */
  addChoice(name, label, options, value) {
    /** @type {HTMLElement} */
    const line = add(this.place, "label", { textContent: label });
    /** @type {HTMLSelectElement} */
    const select = add(line, "select");
    this.setOptions(select, options, value ?? options[0]);
    select.addEventListener("change", () => {
      this.ask(name, select.value);
      select.blur();
    });
    return select;
  }

  /**
   * Offer other options.
   * @param {HTMLSelectElement} select
   * @param {string[]} options
   * @param {string} value
   */
  setOptions(select, options, value) {
    select.replaceChildren(...options.map((option) => new Option(option, option)));
    select.value = value;
    /** @type {HTMLElement} */ (select.parentElement).hidden = options.length < 2;
  }

  /** @param {(typeof SLIDERS)[number]} slider */
  addSlider([name, label, least, most, step]) {
    const line = add(this.place, "label", { textContent: label });
    const output = add(line, "output");
    const properties = { type: "range", min: `${least}`, max: `${most}`, step: `${step}` };
    const input = add(line, "input", properties);
    input.addEventListener("input", () => {
      output.value = input.value;
      this.ask(name, Number(input.value));
    });
    input.addEventListener("change", () => input.blur());
    this.sliders.set(name, { input, output });
  }

  /** @param {Record<string, string>} buttons labels by what they ask */
  addButtons(buttons) {
    const row = add(this.place, "div", { className: "row" });
    for (const [name, textContent] of Object.entries(buttons)) {
      const button = add(row, "button", { textContent, type: "button" });
      button.addEventListener("click", () => {
        this.ask(name, true);
        button.blur();
      });
    }
    return row;
  }

  /** @param {string} name @param {string} label */
  addToggle(name, label) {
    const line = add(this.place, "label", { textContent: label });
    const input = add(line, "input", { type: "checkbox", checked: true });
    input.addEventListener("change", () => {
      this.ask(name, input.checked);
      input.blur();
    });
  }

  /**
   * Show settings.
   * @param {Settings} settings
   */
  show(settings) {
    for (const [name, value] of Object.entries(settings)) {
      const slider = /** @type {Slider} */ (this.sliders.get(name));
      slider.input.value = `${value}`;
      slider.output.value = `${+value.toFixed(3)}`;
    }
  }
}
