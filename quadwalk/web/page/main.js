/** The page: loads a robot, steps it in real time, and draws it. */

import { isSingleFile, loadMujoco, readFile, readText } from "./files.js";
import { Inputs } from "./input.js";
import { readLink, writeLink } from "./link.js";
import { Policy } from "./onnx.js";
import { Panel, find } from "./panel.js";
import { Pilot } from "./pilot.js";
import { drawCurves, drawSteps } from "./plots.js";
import { Recorder } from "./record.js";
import { Server } from "./server.js";
import { Scene } from "./scene.js";
import { Simulation } from "./simulation.js";
import { Terrain } from "./terrain.js";

const BUDGET = 0.025; // s of a frame that steps may take
const PAUSE = 0.25; // s between frames, beyond which time stands still, as in a hidden page
const PLOTTING = 0.1; // s between plots
const TELLING = 6; // s that a message stays
const ENDED = "The program that served this page has ended.";
const FLAT = "flat";
const KICK = 1.5; // m/s, of a kick from the side

/**
 * @typedef {object} Dog
 * @property {string} name
 * @property {string} robot a file's name
 * @property {Record<string, string>} policies files of its policies, by label; the first drives
 * @property {string | null} getup
 * @property {boolean} remote the policy acts where Python is
 * @property {string | null} note what was done to its meshes
 */

/** The page of one robot at a time. */
export class Page {
  constructor() {
    this.scene = new Scene(find("picture"));
    this.panel = new Panel(find("controls"), (name, value) => this.act(name, value));
    this.panel.films.style.display = Recorder.canFilm ? "" : "none";
    this.recorder = new Recorder(this.scene.canvas);
    this.pace = 1;
    this.isPaused = false;
    this.isThrowDue = false;
    this.debt = 0; // s of the robot's time that is due
    this.lastFrame = 0;
    this.plotted = 0;
    this.pilot = new Pilot({});
    /** @type {Promise<import("./desk.js").Desk> | null} */
    this.desk = null;
    /** @type {Uint8Array | null} the newest policy of the first dog, which the server has sent */
    this.newest = null;
    /** @type {Simulation | null} drives beside the robot, while two policies are compared */
    this.rival = null;
    /** @type {string[]} */
    this.dogs = [];
    /** @type {Terrain | null} */
    this.terrain = null;
    this.ground = FLAT;
    this.inputs = new Inputs(
      () => this.pilot,
      (action) => this.act(action, true),
    );
    this.addTouch();
    new ResizeObserver(() => this.scene.resize()).observe(this.scene.canvas);
  }

  addTouch() {
    const stick = { forward: 0, left: 0, turn: 0 };
    const steer = () => this.pilot.steer(stick.forward, stick.left, stick.turn);
    this.inputs.addStick(find("stick-left"), (right, up) => {
      stick.forward = up;
      stick.turn = -right;
      steer();
    });
    this.inputs.addStick(find("stick-right"), (right, up) => {
      stick.left = -right;
      if (up || !stick.forward) stick.forward = up;
      steer();
    });
    for (const button of document.querySelectorAll("#touch button")) {
      const action = /** @type {HTMLElement} */ (button).dataset.act ?? "";
      button.addEventListener("click", () => this.act(action, true));
    }
  }

  /** Load everything and start. */
  async start() {
    this.tell("loading ...", true);
    const [mujoco, index] = await Promise.all([loadMujoco(), readText("dogs.json")]);
    this.mujoco = mujoco;
    const { dogs, terrain, live } = JSON.parse(index);
    this.dogs = dogs;
    this.terrain = terrain ? await Terrain.read(JSON.parse(await readText(terrain))) : null;
    const link = readLink(location.hash);
    const first = this.dogs.find((name) => name === link.dog) ?? this.dogs[0];
    if (live && !isSingleFile) this.server = this.connect();
    await this.open(first, link.ground ?? FLAT);
    this.act("settings", link.settings);
    if (link.script.length) this.pilot.follow(link.script);
    this.tell("");
    requestAnimationFrame((time) => this.onFrame(time));
  }

  connect() {
    return new Server({
      onPolicy: (file) => {
        this.newest = file;
        if (this.dog?.name === this.dogs[0] && !this.rival) this.setPolicy(file);
      },
      onTraining: (message) => this.hear(message),
      onStart: () => this.greet(),
      onEnd: () => this.tell(ENDED, true),
    });
  }

  /** Take back that the program has ended; where it serves another robot now, show that. */
  async greet() {
    if (find("message").textContent === ENDED) this.tell("");
    const { dogs } = JSON.parse(await readText("dogs.json"));
    if (this.dogs.join() !== dogs.join()) location.reload();
  }

  /**
   * Hand a message of the training to its desk, which the first one opens.
   * @param {any} message
   */
  async hear(message) {
    this.desk ??= Promise.all([import("./desk.js"), readText("desk.html")]).then(
      ([{ Desk }, html]) => new Desk(this, html),
    );
    (await this.desk).hear(message);
  }

  /**
   * Show a second robot beside the first, in place of any earlier one.
   * @param {Simulation | null} rival
   */
  setRival(rival) {
    this.scene.setRival(rival);
    this.rival?.delete();
    this.rival = rival;
  }

  /** The robots that are shown: one, or two that are compared. */
  get robots() {
    return [this.simulation, this.rival].filter((robot) => robot instanceof Simulation);
  }

  /**
   * Show a dog on a ground.
   * @param {string} name of the dog
   * @param {string} ground a tile's name, or flat
   */
  async open(name, ground) {
    /** @type {Dog} */
    const dog = JSON.parse(await readText(`${name}.dog.json`));
    const [policy, getup, xml] = await Promise.all([
      readFile(Object.values(dog.policies)[0]),
      dog.getup ? readFile(dog.getup) : null,
      readText(dog.robot),
    ]);
    this.setRival(null);
    this.simulation?.delete();
    const names = this.groundNames();
    const tile = names.indexOf(ground) - 1;
    const simulation = new Simulation(this.mujoco, {
      xml,
      policy: new Policy((name === this.dogs[0] && this.newest) || policy),
      getup: getup && new Policy(getup),
      terrain: tile >= 0 ? this.terrain : null,
      remote: dog.remote,
    });
    simulation.tile = Math.max(tile, 0);
    simulation.onEvent = (event) => this.tell(event);
    simulation.reset();
    const { script, release } = this.pilot;
    this.pilot = new Pilot(simulation.driver.metadata);
    this.pilot.release = release;
    if (this.simulation && !script) this.pilot.stop();
    this.simulation = simulation;
    this.dog = dog;
    this.ground = tile >= 0 ? ground : FLAT;
    this.scene.setSimulation(simulation);
    this.panel.setOptions(this.panel.dogs, this.dogs, name);
    this.panel.setOptions(this.panel.checkpoints, Object.keys(dog.policies), "last");
    this.panel.setOptions(this.panel.grounds, names, this.ground);
    this.panel.show(simulation.settings);
    this.recorder.clear();
    this.showAbout();
    this.showHint();
  }

  /** Return the names of all grounds, flat first and then tile by tile. */
  groundNames() {
    const tiles = this.terrain?.tiles ?? [];
    return [FLAT, ...tiles.map(({ kind, difficulty }) => `${kind}, ${difficulty.toFixed(1)}`)];
  }

  showAbout() {
    const { run_path: run, training_steps: steps } = this.simulation?.driver.metadata ?? {};
    const about = `${run}: trained in ${Number(steps).toLocaleString("en")} steps on a CPU`;
    const note = this.dog?.note ? `; to see it, ${this.dog.note}` : "";
    find("about").textContent = `${about}, with quadwalk${note}`;
  }

  showHint() {
    find("hint").innerHTML = this.pilot.isSteered
      ? "<kbd>W A S D</kbd> drive, <kbd>Q E</kbd> aside, <kbd>shift</kbd> gallop, " +
        "<kbd>space</kbd> stop, <kbd>K</kbd> kick, <kbd>T</kbd> throw, <kbd>C</kbd> camera"
      : "It runs as fast as it can: <kbd>K</kbd> kick, <kbd>R</kbd> reset, <kbd>C</kbd> camera";
  }

  /**
   * Do what a key or a control asks.
   * @param {string} name
   * @param {any} value
   */
  act(name, value) {
    const { simulation } = this;
    if (!simulation) return;
    if (name in simulation.settings) this.change({ [name]: value });
    /** @type {Record<string, () => void>} */
    const actions = {
      settings: () => this.change(value),
      defaults: () => this.change(simulation.defaults()),
      dog: () => this.choose(value, this.ground),
      checkpoint: () => this.load(value),
      ground: () => this.choose(this.dog?.name ?? "", value),
      pace: () => (this.pace = Number(value)),
      release: () => (this.pilot.release = value),
      stop: () => this.pilot.stop(),
      kick: () => this.robots.forEach((robot) => robot.push(0, KICK)),
      throw: () => (this.isThrowDue = true),
      reset: () => {
        this.robots.forEach((robot) => robot.reset());
        this.recorder.clear();
      },
      pause: () => {
        this.isPaused = !this.isPaused;
        this.tell(this.isPaused ? "paused" : "", this.isPaused);
      },
      camera: () => this.tell(`camera: ${this.scene.nextCamera()}`),
      forces: () => (this.scene.showsForces = value),
      trail: () => (this.scene.showsTrail = value),
      plots: () => (find("plots").style.display = value ? "" : "none"),
      link: () => this.copyLink(),
      film: () => {
        this.scene.sharpen();
        this.recorder.film();
      },
    };
    actions[name]?.();
  }

  /**
   * Drive with another policy of the run.
   * @param {string} label
   */
  load(label) {
    const name = this.dog?.policies[label] ?? "";
    readFile(name).then(
      (file) => this.setPolicy(file),
      (error) => this.tell(error.message),
    );
  }

  /** @param {Uint8Array} file */
  setPolicy(file) {
    this.simulation?.setPolicy(new Policy(file));
    this.showAbout();
  }

  /** @param {Partial<import("./simulation.js").Settings>} settings */
  change(settings) {
    this.robots.forEach((robot) => robot.change(settings));
    if (this.simulation) this.panel.show(this.simulation.settings);
  }

  /** @param {string} name of a dog @param {string} ground */
  choose(name, ground) {
    this.tell("loading ...", true);
    this.open(name, ground).then(
      () => this.tell(""),
      (error) => {
        this.tell(error.message, true);
        this.panel.dogs.value = this.dog?.name ?? "";
      },
    );
  }

  copyLink() {
    const { simulation, dog } = this;
    if (!simulation || !dog) return;
    const { settings } = simulation;
    const { script } = this.recorder;
    const hash = writeLink(dog.name, this.ground, settings, simulation.defaults(), script);
    history.replaceState(null, "", hash);
    this.tell("The link is in the address bar, and copied where the browser allows that.");
    navigator.clipboard?.writeText(location.href).catch(() => {});
  }

  /**
   * Show a message.
   * @param {string} text
   * @param {boolean} stays
   */
  tell(text, stays = false) {
    const message = find("message");
    message.textContent = text;
    message.hidden = !text;
    clearTimeout(this.timer);
    if (text && !stays) this.timer = setTimeout(() => (message.hidden = true), 1000 * TELLING);
  }

  /** @param {number} now ms */
  onFrame(now) {
    const dt = Math.min((now - this.lastFrame) / 1000, PAUSE);
    this.lastFrame = now;
    this.inputs.readGamepad();
    const shown = this.recorder.next(dt);
    if (shown) this.showState(shown.qpos);
    else if (!this.isPaused) this.advance(dt);
    if (!shown) this.scene.adapt(dt);
    this.scene.draw(dt);
    if (now / 1000 - this.plotted > PLOTTING) {
      this.plotted = now / 1000;
      this.showNumbers();
    }
    requestAnimationFrame((time) => this.onFrame(time));
  }

  /**
   * Show a state of before; the simulation goes on from it.
   * @param {Float64Array} qpos
   */
  showState(qpos) {
    const simulation = /** @type {Simulation} */ (this.simulation);
    simulation.data.qpos.set(qpos);
    simulation.forces = []; // they were not kept
    simulation.mujoco.mj_kinematics(simulation.model, simulation.data);
  }

  /**
   * Step as many control steps as `dt` is long.
   * @param {number} dt s on the wall
   */
  advance(dt) {
    const simulation = /** @type {Simulation} */ (this.simulation);
    const { period } = simulation;
    this.debt += dt * this.pace;
    const start = performance.now();
    while (this.debt >= period) {
      if (performance.now() - start > 1000 * BUDGET) {
        this.debt = 0; // slower than real time: what is due is dropped
        break;
      }
      const asks = this.dog?.remote && !simulation.isRising;
      const targets = asks ? this.server?.askTargets(simulation, this.pilot.command) : undefined;
      if (targets === null) break; // they have not come yet
      this.step(simulation, targets);
      this.debt -= period;
    }
  }

  /**
   * Make a control step.
   * @param {Simulation} simulation
   * @param {ArrayLike<number>} [targets] (12,) rad, where another machine computes them
   */
  step(simulation, targets) {
    const { period } = simulation;
    const command = this.pilot.update(period);
    if (this.isThrowDue && simulation.isStanding && !simulation.isRising) {
      this.robots.forEach((robot) => robot.throw());
      this.isThrowDue = false;
    }
    simulation.step(command, targets);
    this.rival?.step(command);
    if (this.rival && this.rival.time !== simulation.time) this.act("reset", true);
    const [speed] = simulation.velocity;
    const qpos = Float64Array.from(simulation.data.qpos);
    this.recorder.add(period, { qpos, command, speed, contacts: simulation.contacts });
  }

  showNumbers() {
    const simulation = /** @type {Simulation} */ (this.simulation);
    const { samples } = this.recorder;
    drawCurves(find("curves"), samples);
    drawSteps(find("steps"), samples);
    const recent = samples.slice(-15);
    const mean = recent.reduce((sum, { speed }) => sum + speed, 0) / Math.max(recent.length, 1);
    find("speed").innerHTML = `<b>${Math.abs(mean) < 0.05 ? "0.0" : mean.toFixed(1)}</b> m/s`;
    const [forward, , turn] = this.pilot.command;
    const asked = `command ${forward.toFixed(1)} m/s, ${turn.toFixed(1)} rad/s`;
    find("command").textContent = this.pilot.isSteered ? asked : "";
    const state = simulation.isRising ? "getting up" : simulation.isFallen ? "fallen" : "";
    find("state").textContent = state;
  }
}

/** Make the page; where the browser cannot draw it, say so. */
function makePage() {
  try {
    return new Page();
  } catch (error) {
    const message = find("message");
    message.textContent = `this page needs WebGL 2: ${/** @type {Error} */ (error).message}`;
    message.hidden = false;
    throw error;
  }
}

const page = makePage();
/** For the console, and for tests. */
/** @type {any} */ (globalThis).quadwalk = page;
page.start().catch((error) => page.tell(error.message, true));
