/** The last seconds, which plots and links show, and a film. */

const SECONDS = 10; // that are kept

/**
 * @typedef {object} Sample a control step
 * @property {number} time s since the page's start, without pauses
 * @property {Float64Array} qpos (19,)
 * @property {number[]} command (3,)
 * @property {number} speed m/s
 * @property {boolean[]} contacts (4,)
 */

/** Keeps the control steps of the last seconds, and films them when they are shown again. */
export class Recorder {
  /** @param {HTMLCanvasElement} canvas that is filmed */
  constructor(canvas) {
    this.canvas = canvas;
    this.time = 0;
    /** @type {{samples: Sample[], time: number} | null} */
    this.replay = null;
    this.clear();
  }

  /** Return true if this browser can film. */
  static get canFilm() {
    return typeof MediaRecorder === "function" && "captureStream" in HTMLCanvasElement.prototype;
  }

  clear() {
    /** @type {Sample[]} */
    this.samples = [];
  }

  /** @param {number} dt s @param {Omit<Sample, "time">} sample */
  add(dt, sample) {
    this.time += dt;
    this.samples.push({ time: this.time, ...sample });
    if (this.samples[0].time < this.time - SECONDS) this.samples.shift();
  }

  /** Return the commands as a script: seconds, and a command (3,). */
  get script() {
    /** @type {[number, number[]][]} */
    const parts = [];
    this.samples.forEach(({ time, command }, k) => {
      const dt = time - (this.samples[k - 1]?.time ?? time);
      const last = parts.at(-1);
      if (last?.[1].every((x, axis) => x === command[axis])) last[0] += dt;
      else parts.push([dt, command]);
    });
    return parts;
  }

  /** Start to show the last seconds again; what is shown until they end becomes a file. */
  film() {
    const [first] = this.samples;
    if (this.replay || !first) return;
    const stream = this.canvas.captureStream();
    const recorder = new MediaRecorder(stream, { mimeType: "video/webm" });
    recorder.ondataavailable = (event) => saveFile(event.data, "quadwalk.webm");
    recorder.start();
    this.recorder = recorder;
    this.replay = { samples: [...this.samples], time: first.time };
  }

  /**
   * Return the sample to show after `dt` more seconds; null where none is shown again.
   * @param {number} dt s
   */
  next(dt) {
    const { replay } = this;
    if (!replay) return null;
    replay.time += dt;
    const sample = replay.samples.find(({ time }) => time >= replay.time);
    if (sample) return sample;
    this.recorder?.stop();
    this.replay = null;
    return null;
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
