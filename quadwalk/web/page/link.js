/** What a link carries: settings and a sequence of commands. And the last seconds as a film. */

/** @typedef {import("./simulation.js").Settings} Settings */

const FILM = 10; // s

/**
 * Read the part of a link after "#".
 *
 * Settings are `name=number`; `do=1.5:0,0,0;3:1,0,0` are seconds and commands; `dog=NAME` chooses.
 * @param {string} hash
 */
export function readLink(hash) {
  const values = new URLSearchParams(hash.replace(/^#/, ""));
  /** @type {Record<string, number>} */
  const settings = {};
  for (const name of ["friction", "payload", "strength", "latency", "noise", "pushes"]) {
    const value = Number(values.get(name));
    if (values.has(name) && Number.isFinite(value)) settings[name] = value;
  }
  return {
    dog: values.get("dog"),
    ground: values.get("ground"),
    settings,
    script: readScript(values.get("do")),
  };
}

/**
 * Read a sequence of commands; what is none is left out.
 * @param {string | null} text
 * @returns {[number, number[]][]}
 */
function readScript(text) {
  if (!text) return [];
  const parts = text.split(";").map((part) => {
    const [seconds, command = ""] = part.split(":");
    return /** @type {[number, number[]]} */ ([Number(seconds), command.split(",").map(Number)]);
  });
  return parts.filter(([seconds, command]) => {
    const numbers = [seconds, ...command];
    return command.length === 3 && seconds > 0 && numbers.every(Number.isFinite);
  });
}

/**
 * Write the part of a link after "#".
 * @param {string} dog
 * @param {string} ground
 * @param {Settings} settings
 * @param {Settings} defaults
 * @param {[number, number[]][]} script
 */
export function writeLink(dog, ground, settings, defaults, script) {
  const values = new URLSearchParams({ dog });
  if (ground !== "flat") values.set("ground", ground);
  for (const [name, value] of Object.entries(settings)) {
    if (value !== /** @type {any} */ (defaults)[name]) values.set(name, String(value));
  }
  const parts = script.map(
    ([seconds, command]) => `${seconds.toFixed(2)}:${command.map((x) => +x.toFixed(2)).join(",")}`,
  );
  if (parts.length) values.set("do", parts.join(";"));
  return `#${values}`;
}

/** Remembers the commands of the last seconds. */
export class CommandLog {
  constructor() {
    this.clear();
  }

  clear() {
    /** @type {[number, number[]][]} */
    this.parts = [];
  }

  /** @param {number[]} command @param {number} dt s */
  add(command, dt) {
    const last = this.parts.at(-1);
    if (last && last[1].every((x, k) => x === command[k])) last[0] += dt;
    else this.parts.push([dt, [...command]]);
    if (this.parts.length > 60) this.parts.shift();
  }
}

/** Keeps the states of the last seconds, and films them when they are shown again. */
export class Film {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    /** @type {{time: number, qpos: Float64Array}[]} */
    this.states = [];
    /** @type {{states: {time: number, qpos: Float64Array}[], elapsed: number} | null} */
    this.replay = null;
  }

  /** Return true if this browser can film. */
  static get isPossible() {
    return typeof MediaRecorder === "function" && "captureStream" in HTMLCanvasElement.prototype;
  }

  clear() {
    this.states = [];
  }

  /** @param {number} time s @param {Float64Array} qpos */
  add(time, qpos) {
    this.states.push({ time, qpos: Float64Array.from(qpos) });
    while (this.states[0].time < time - FILM) this.states.shift();
  }

  /** Start to show the last seconds again; what is shown until they end becomes a file. */
  save() {
    if (this.replay || this.states.length < 2) return;
    const stream = this.canvas.captureStream(30);
    const recorder = new MediaRecorder(stream, { mimeType: "video/webm" });
    recorder.ondataavailable = (event) => saveFile(event.data, "quadwalk.webm");
    recorder.start();
    this.recorder = recorder;
    this.replay = { states: [...this.states], elapsed: 0 };
  }

  /**
   * Return the state to show after `dt` more seconds; null where none is shown again.
   * @param {number} dt s
   */
  next(dt) {
    const { replay } = this;
    if (!replay) return null;
    replay.elapsed += dt;
    const time = replay.states[0].time + replay.elapsed;
    const state = replay.states.find((candidate) => candidate.time >= time);
    if (!state) {
      this.recorder?.stop();
      this.replay = null;
    }
    return state ?? null;
  }
}

/**
 * Hand a file over to the user.
 * @param {Blob} content
 * @param {string} name
 */
function saveFile(content, name) {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(content);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
}
