/**
 * Run the page's own modules in Node: node run_policy.mjs PAGE VENDOR JOB.json
 *
 * A job names the files of a robot, and either `states`, at which the policy is asked for its
 * observations and joint targets, or `episodes`, which are simulated. A job of `models` loads them
 * and returns their sizes. The answer is JSON.
 */

import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";
import zlib from "node:zlib";

const [page, vendor, jobFile] = process.argv.slice(2);
const load = (folder, name) =>
  import(pathToFileURL(path.join(folder, name)).href);
const { Policy } = await load(page, "onnx.js");
const { Controller } = await load(page, "controller.js");
const { Simulation } = await load(page, "simulation.js");
const { Terrain } = await load(page, "terrain.js");

const job = JSON.parse(fs.readFileSync(jobFile, "utf8"));
const readPolicy = (file) =>
  file ? new Policy(new Uint8Array(fs.readFileSync(file))) : null;

/** Return the observations and joint targets at each state, one after another. */
function askPolicy() {
  const controller = new Controller(readPolicy(job.policy));
  return job.states.map(({ qpos, qvel, command }) => {
    const targets = Array.from(controller.computeTargets(qpos, qvel, command));
    return { obs: Array.from(controller.obs), targets };
  });
}

/** Start MuJoCo's WebAssembly module. */
async function startMujoco() {
  const { default: loadMujoco } = await load(vendor, "mujoco.js");
  const wasmBinary = zlib.gunzipSync(
    fs.readFileSync(path.join(vendor, "mujoco.wasm.gz")),
  );
  return loadMujoco({ wasmBinary });
}

/** Load each model; return how many coordinates, shapes and triangles it has. */
async function loadModels() {
  const mujoco = await startMujoco();
  return job.models.map((file) => {
    const xml = fs.readFileSync(file, "utf8");
    const model = mujoco.MjModel.from_xml_string(xml);
    const { nq, ngeom, nmeshface } = model;
    model.delete();
    return { nq, ngeom, nmeshface };
  });
}

/** Simulate each episode; return its mean velocities after the first seconds, and its events. */
async function simulate() {
  const mujoco = await startMujoco();
  const terrain = job.terrain
    ? await Terrain.read(JSON.parse(fs.readFileSync(job.terrain)))
    : null;
  const simulation = new Simulation(mujoco, {
    xml: fs.readFileSync(job.robot, "utf8"),
    policy: readPolicy(job.policy),
    getup: readPolicy(job.getup),
    terrain,
  });
  return job.episodes.map((episode) => {
    const events = [];
    simulation.onEvent = (event) => events.push(event);
    simulation.tile = episode.tile ?? 0;
    simulation.reset();
    simulation.change({ ...simulation.defaults(), ...episode.settings });
    (episode.joints ?? []).forEach(
      (angle, k) => (simulation.data.qpos[7 + k] += angle),
    );
    const velocity = [0, 0, 0];
    let fell = false;
    let rising = 0;
    for (let step = 0; step < episode.steps; step++) {
      if (step === episode.throwAt) simulation.throw();
      simulation.step(episode.command);
      fell ||= simulation.isFallen;
      rising += Number(simulation.isRising);
      if (step < episode.settle) continue;
      simulation.velocity.forEach(
        (x, k) => (velocity[k] += x / (episode.steps - episode.settle)),
      );
    }
    const forces = simulation.forces.reduce(
      (sum, { force }) => sum + force[2],
      0,
    );
    const place = Array.from(simulation.data.qpos.subarray(0, 3));
    const { isStanding, contacts } = simulation;
    return {
      velocity,
      fell,
      rising,
      events,
      isStanding,
      contacts,
      forces,
      place,
    };
  });
}

const answer = job.models
  ? loadModels()
  : job.states
    ? askPolicy()
    : simulate();
console.log(JSON.stringify(await answer));
