/** The last seconds as curves and as a strip of footfalls. */

const SECONDS = 6; // that are shown
const LEGS = ["FR", "FL", "RR", "RL"];
export const INK = "#14202b";
export const COMMAND = "#8695a4";
export const SPEED = "#d9541e";

/**
 * @typedef {object} Sample
 * @property {number} time s
 * @property {number} command forward velocity, m/s
 * @property {number} speed m/s
 * @property {boolean[]} contacts (4,)
 */

/**
 * Return a canvas's context, cleared; it has two pixels for each of the page's.
 * @param {HTMLCanvasElement} canvas
 */
export function prepare(canvas) {
  const [width, height] = [canvas.width / 2, canvas.height / 2];
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(2, 0, 0, 2, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, sans-serif";
  return { context, width, height };
}

/**
 * Draw a line through points, which are pixels.
 * @param {CanvasRenderingContext2D} context
 * @param {number[][]} points
 * @param {string} color
 */
export function drawLine(context, points, color) {
  context.beginPath();
  context.strokeStyle = color;
  context.lineWidth = 1.8;
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
}

/** Keeps and draws the last seconds. */
export class Plots {
  /** @param {HTMLCanvasElement} curves @param {HTMLCanvasElement} steps */
  constructor(curves, steps) {
    this.curves = curves;
    this.steps = steps;
    this.clear();
  }

  clear() {
    /** @type {Sample[]} */
    this.samples = [];
  }

  /** @param {Sample} sample */
  add(sample) {
    const { samples } = this;
    if (samples.length && sample.time < samples[samples.length - 1].time) this.clear();
    this.samples.push(sample);
    while (this.samples[0].time < sample.time - SECONDS) this.samples.shift();
  }

  draw() {
    if (!this.samples.length || !this.curves.clientWidth) return;
    this.drawCurves();
    this.drawSteps();
  }

  drawCurves() {
    const { context, width, height } = prepare(this.curves);
    const { samples } = this;
    const values = samples.flatMap(({ command, speed }) => [command, speed]);
    const low = Math.min(0, ...values);
    const high = Math.max(1, ...values);
    const end = samples[samples.length - 1].time;
    const toX = (/** @type {number} */ time) => width * (1 - (end - time) / SECONDS);
    const toY = (/** @type {number} */ value) =>
      height - 6 - ((height - 22) * (value - low)) / (high - low);
    const commands = samples.map(({ time, command }) => [toX(time), toY(command)]);
    const speeds = samples.map(({ time, speed }) => [toX(time), toY(speed)]);
    drawLine(context, commands, COMMAND);
    drawLine(context, speeds, SPEED);
    context.fillStyle = COMMAND;
    context.fillText("command", 6, 12);
    context.fillStyle = SPEED;
    context.fillText("speed, m/s", 14 + context.measureText("command").width, 12);
    context.fillStyle = INK;
    context.fillText(high.toFixed(1), width - 22, 12);
  }

  drawSteps() {
    const { context, width, height } = prepare(this.steps);
    const { samples } = this;
    const end = samples[samples.length - 1].time;
    const shown = SECONDS / 3; // strides are seen at this scale
    const row = height / LEGS.length;
    const toX = (/** @type {number} */ time) => 24 + (width - 24) * (1 - (end - time) / shown);
    LEGS.forEach((leg, k) => {
      context.fillStyle = INK;
      context.fillText(leg, 5, row * k + row / 2 + 4);
      samples.forEach((sample, index) => {
        const next = samples[index + 1]?.time ?? end;
        if (!sample.contacts[k] || sample.time < end - shown) return;
        const x = toX(sample.time);
        context.fillRect(x, row * k + 2, toX(next) - x + 0.5, row - 4);
      });
    });
  }
}
