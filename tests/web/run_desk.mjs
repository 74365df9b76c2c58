/**
 * Run the desk's own arithmetic in Node: node run_desk.mjs PAGE VENDOR JOB.json
 *
 * A job has `values` and `positions` on the slider of a number that starts with `start`, `moves` of
 * a slider as [ms, value], and the `figures` of iterations, of which `most` are kept. The answer is
 * JSON.
 */

import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [page, , jobFile] = process.argv.slice(2);
const { Course, Sender, findTop, toPosition, toValue } = await import(
  pathToFileURL(path.join(page, "dials.js")).href
);
const job = JSON.parse(fs.readFileSync(jobFile, "utf8"));
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Move a slider; return the messages as [ms, value]. */
async function move() {
  const start = performance.now();
  const sent = [];
  const sender = new Sender((_, value) =>
    sent.push([performance.now() - start, value]),
  );
  for (const [ms, value] of job.moves) {
    await wait(start + ms - performance.now());
    sender.set("scale", value);
  }
  await wait(600);
  return sent;
}

const top = findTop(job.start);
const course = new Course(job.most);
job.figures.forEach((value, step) => course.add(step, step, { speed: value }));
const answer = {
  top,
  values: job.positions.map((position) => toValue(position, top)),
  positions: job.values.map((value) => toPosition(value, top)),
  sent: await move(),
  course: course.samples.map(({ steps, values }) => [steps, values.speed]),
};
console.log(JSON.stringify(answer));
