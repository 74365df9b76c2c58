/** The last seconds as curves and as a strip of footfalls. */

const SECONDS = 6; // that curves show
const STRIDES = 2; // s, that footfalls show
const LEGS = ["FR", "FL", "RR", "RL"];
export const INK = "#14202b";
export const COMMAND = "#8695a4";
export const SPEED = "#d9541e";

/** @typedef {import("./record.js").Sample} Sample */

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

/**
 * Draw the command and the speed over time.
 * @param {HTMLCanvasElement} canvas
 * @param {Sample[]} samples
 */
export function drawCurves(canvas, samples) {
  const { context, width, height } = prepare(canvas);
  const end = samples.at(-1)?.time ?? 0;
  const shown = samples.filter(({ time }) => time > end - SECONDS);
  const values = shown.flatMap(({ command, speed }) => [command[0], speed]);
  const low = Math.min(0, ...values);
  const high = Math.max(1, ...values);
  const toX = (/** @type {number} */ time) => width * (1 - (end - time) / SECONDS);
  const toY = (/** @type {number} */ value) =>
    height - 6 - ((height - 22) * (value - low)) / (high - low);
  const commands = shown.map(({ time, command }) => [toX(time), toY(command[0])]);
  const speeds = shown.map(({ time, speed }) => [toX(time), toY(speed)]);
  drawLine(context, commands, COMMAND);
  drawLine(context, speeds, SPEED);
  context.fillStyle = COMMAND;
  context.fillText("command", 6, 12);
  context.fillStyle = SPEED;
  context.fillText("speed, m/s", 14 + context.measureText("command").width, 12);
  context.fillStyle = INK;
  context.fillText(high.toFixed(1), width - 22, 12);
}

/**
 * Draw when each foot touches the ground.
 * @param {HTMLCanvasElement} canvas
 * @param {Sample[]} samples
 */
export function drawSteps(canvas, samples) {
  const { context, width, height } = prepare(canvas);
  const end = samples.at(-1)?.time ?? 0;
  const row = height / LEGS.length;
  const toX = (/** @type {number} */ time) => 24 + (width - 24) * (1 - (end - time) / STRIDES);
  LEGS.forEach((leg, k) => {
    context.fillStyle = INK;
    context.fillText(leg, 5, row * k + row / 2 + 4);
    samples.forEach(({ time, contacts }, index) => {
      if (!contacts[k] || time < end - STRIDES) return;
      const next = samples[index + 1]?.time ?? end;
      context.fillRect(toX(time), row * k + 2, toX(next) - toX(time) + 0.5, row - 4);
    });
  });
}
