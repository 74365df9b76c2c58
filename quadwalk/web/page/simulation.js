/** One robot in MuJoCo: its policies, stepped by control steps, changed while it runs. */

import { Controller, readNumbers, toMatrix } from "./controller.js";

/** @typedef {import("./onnx.js").Policy} Policy */
/** @typedef {import("./terrain.js").Terrain} Terrain */

const TIMESTEP = 0.002; // s, of physics
const FALLEN = Math.cos(Math.PI / 3); // cosine of the trunk's tilt beyond which it has fallen
const LOW = 0.4; // share of its height at the start below which it has fallen too
const UPRIGHT = Math.cos(Math.PI / 10); // within that tilt,
const HIGH = 0.85; // and above that share of its height,
const STEADY = 0.5; // s long, it stands again
const LYING = 2; // s on the ground until a robot that cannot get up is put on its feet
const RISING = 10; // s that a policy has to get up
const EDGE = 1.5; // m from the end of the field at which it is put back to its start
const MAX_SPEED = 1000; // m/s or rad/s, beyond which a state is no robot's
const PUSHING = 3; // s, in which one push comes
const MAX_LATENCY = 0.06; // s, that joint targets can be late

/**
 * @typedef {object} Settings
 * @property {number} friction sliding friction of floor and feet
 * @property {number} payload kg, in the trunk's center of mass
 * @property {number} strength factor of the motors' torque
 * @property {number} latency s, of joint targets
 * @property {number} noise level of the sensors' noise; 1 is what training states
 * @property {number} pushes m/s, of pushes from any side, one in each `PUSHING` s
 */

/**
 * @typedef {object} Robot
 * @property {string} xml MJCF
 * @property {Policy} policy drives
 * @property {Policy | null} getup gets it up where it has fallen
 * @property {Terrain | null} terrain
 * @property {boolean} [remote] another machine computes its joint targets
 */

/** A robot that lives in MuJoCo. */
export class Simulation {
  /** @param {any} mujoco the WebAssembly module @param {Robot} robot */
  constructor(mujoco, robot) {
    this.mujoco = mujoco;
    this.robot = robot;
    this.terrain = robot.terrain;
    this.driver = new Controller(robot.policy);
    if (!robot.remote) this.driver.checkObservations();
    this.riser = robot.getup ? new Controller(robot.getup) : null;
    this.controller = this.driver;
    const { metadata } = robot.policy;
    this.start = readNumbers(metadata.start_qpos);
    this.period = Number(metadata.control_period);
    this.substeps = Math.max(1, Math.round(this.period / TIMESTEP));
    this.model = mujoco.MjModel.from_xml_string(this.terrain?.layInto(robot.xml) ?? robot.xml);
    this.terrain?.fill(this.model);
    this.model.opt.timestep = this.period / this.substeps;
    this.model.dof_frictionloss.fill(0); // it is part of the controller's torque, as in training
    this.data = new mujoco.MjData(this.model);
    this.masses = Float64Array.from(this.model.body_mass);
    this.trunk = this.model.jnt_bodyid[0];
    this.legs = this.findLegs();
    /** @type {Settings} */
    this.settings = this.defaults();
    this.tile = 0;
    /** What a drag pulls at: a body, and the force, N, and torque, Nm, on it in world axes. */
    this.pull = { body: 0, force: [0, 0, 0], torque: [0, 0, 0] };
    /** @type {(event: string) => void} */
    this.onEvent = () => {};
    /** @type {ArrayLike<number>[]} the joint targets of the last control steps, newest first */
    this.recent = [];
    /** @type {{point: number[], force: number[]}[]} the ground's forces on feet, N, at m */
    this.forces = [];
    this.contacts = [false, false, false, false];
    this.time = 0;
    this.lying = 0;
    this.steady = 0;
    this.reset();
  }

  /** @returns {Settings} */
  defaults() {
    const friction = Number(this.driver.metadata.ground_friction);
    return { friction, payload: 0, strength: 1, latency: 0, noise: 0, pushes: 0 };
  }

  /** Return the leg, 0 to 3, that each geom touches the floor for as its foot; -1 for none. */
  findLegs() {
    const { geom_bodyid: bodies, body_parentid: parents, jnt_bodyid: moved } = this.model;
    const calves = [3, 6, 9, 12].map((joint) => moved[joint]);
    return Array.from(bodies, (/** @type {number} */ body) =>
      calves.findIndex((calf) => calf === body || calf === parents[body]),
    );
  }

  /**
   * Change some settings, with effect from the next step on.
   * @param {Partial<Settings>} settings
   */
  change(settings) {
    Object.assign(this.settings, settings);
    const { data, model } = this;
    for (let geom = 0; geom < model.ngeom; geom++) {
      model.geom_friction[3 * geom] = this.settings.friction;
    }
    model.body_mass.set(this.masses);
    model.body_mass[this.trunk] += this.settings.payload;
    const [qpos, qvel] = [data.qpos.slice(), data.qvel.slice()];
    this.mujoco.mj_setConst(model, data); // inverse inertias at contacts follow from masses
    data.qpos.set(qpos);
    data.qvel.set(qvel);
    this.mujoco.mj_forward(model, data);
  }

  /** Stand in the first pose, at rest, at the start of its tile. */
  reset() {
    const { data, terrain } = this;
    this.mujoco.mj_resetData(this.model, data);
    data.qpos.set(this.start);
    if (terrain) {
      const [x, y] = terrain.tiles[this.tile].start;
      const reach = [-0.3, -0.15, 0, 0.15, 0.3]; // m, about the trunk, where feet may stand
      const levels = reach.flatMap((a) => reach.map((b) => terrain.heightAt(x + a, y + b)));
      data.qpos[0] = x;
      data.qpos[1] = y;
      data.qpos[2] += Math.max(...levels);
    }
    this.mujoco.mj_forward(this.model, data);
    this.time = 0;
    this.lying = 0;
    this.steady = 0;
    this.takeOver(this.driver);
  }

  /**
   * Let another policy act from now on.
   * @param {Controller} controller
   */
  takeOver(controller) {
    this.controller = controller;
    controller.restart();
    const late = Math.ceil(MAX_LATENCY / this.period) + 1;
    this.recent = Array(late).fill(this.driver.home);
  }

  /**
   * Drive with another policy of the same robot.
   * @param {Policy} policy
   */
  setPolicy(policy) {
    const drives = this.controller === this.driver;
    this.driver = new Controller(policy);
    if (drives) this.takeOver(this.driver);
  }

  /** Return true if the robot's second policy is getting it up. */
  get isRising() {
    return this.controller === this.riser;
  }

  /** (9,) rows of the rotation from the trunk's frame to the world's */
  get rotation() {
    return toMatrix(this.data.qpos.subarray(3, 7));
  }

  /** rad, of the trunk's x axis from the world's */
  get heading() {
    const R = this.rotation;
    return Math.atan2(R[3], R[0]);
  }

  /** (3,) what a command sets: forward and lateral velocity, m/s, and yaw rate, rad/s */
  get velocity() {
    const { qvel } = this.data;
    const R = this.rotation;
    const [cos, sin] = [Math.cos(this.heading), Math.sin(this.heading)];
    const forward = cos * qvel[0] + sin * qvel[1];
    const lateral = cos * qvel[1] - sin * qvel[0];
    return [forward, lateral, R[6] * qvel[3] + R[7] * qvel[4] + R[8] * qvel[5]];
  }

  /** m, of the trunk's origin above the ground below it */
  get height() {
    const [x, y, z] = this.data.qpos;
    return z - (this.terrain?.heightAt(x, y) ?? 0);
  }

  /** Return true if the trunk is tipped over or low. */
  get isFallen() {
    return this.rotation[8] < FALLEN || this.height < LOW * this.start[2];
  }

  /** Return true if the trunk is upright and high. */
  get isStanding() {
    return this.rotation[8] > UPRIGHT && this.height > HIGH * this.start[2];
  }

  /**
   * Change the trunk's velocity in an instant.
   * @param {number} forward m/s along its heading
   * @param {number} left m/s
   */
  push(forward, left) {
    const [cos, sin] = [Math.cos(this.heading), Math.sin(this.heading)];
    this.data.qvel[0] += cos * forward - sin * left;
    this.data.qvel[1] += sin * forward + cos * left;
  }

  /** Throw it over. */
  throw() {
    this.push(0, 3.5);
    this.data.qvel[3] -= 12; // rad/s
  }

  /**
   * Make one control step.
   * @param {ArrayLike<number>} command (3,)
   * @param {ArrayLike<number>} [remote] (12,) rad, targets that another machine computed
   */
  step(command, remote) {
    const { data, model, mujoco, settings, controller, substeps, pull } = this;
    const { qpos, qvel } = data;
    const target =
      remote ?? controller.computeTargets(qpos, qvel, command, this.terrain, settings.noise);
    this.recent.unshift(target);
    this.recent.pop();
    const delay = Math.round(settings.latency / model.opt.timestep);
    data.xfrc_applied.fill(0);
    data.xfrc_applied.set([...pull.force, ...pull.torque], 6 * pull.body);
    if (settings.pushes && Math.random() < this.period / PUSHING) {
      const side = 2 * Math.PI * Math.random();
      this.push(settings.pushes * Math.cos(side), settings.pushes * Math.sin(side));
    }
    for (let substep = 0; substep < substeps; substep++) {
      const late = Math.max(delay - substep + substeps - 1, 0);
      const age = Math.min(Math.floor(late / substeps), this.recent.length - 1);
      const torque = data.qfrc_applied;
      controller.applyTorque(this.recent[age], data.qpos, data.qvel, settings.strength, torque);
      mujoco.mj_step(model, data);
    }
    this.time += this.period;
    this.readContacts();
    this.supervise();
  }

  /** Note the feet that touch, and the ground's force on each, N. */
  readContacts() {
    const { data } = this;
    const contacts = data.contact;
    this.forces = [];
    this.contacts = [false, false, false, false];
    for (let k = 0; k < data.ncon; k++) {
      const contact = contacts.get(k);
      const leg = contact.geom1 === 0 ? this.legs[contact.geom2] : -1; // 0 is the floor
      if (leg >= 0 && contact.efc_address >= 0) {
        this.contacts[leg] = true;
        this.forces.push(this.readForce(contact));
      }
      contact.delete();
    }
    contacts.delete();
  }

  /**
   * Return the point, m, and the ground's force, N, of a contact, in world axes.
   * @param {any} contact
   */
  readForce(contact) {
    const { data } = this;
    const point = Array.from(contact.pos);
    const normal = Array.from(contact.frame).slice(0, 3); // from the floor up
    const rows = contact.dim === 1 ? 1 : 2 * (contact.dim - 1); // of a pyramidal cone
    let size = 0;
    for (let row = 0; row < rows; row++) size += data.efc_force[contact.efc_address + row];
    return { point, force: normal.map((x) => size * x) };
  }

  /** Hand over to the policy that gets it up and back; put it on its feet where none can. */
  supervise() {
    const { data, period } = this;
    const fastest = Math.max(...Array.from(data.qvel, Math.abs));
    if (!(fastest < MAX_SPEED)) return this.putBack("The numbers ran away: put back to the start");
    const [x, y] = data.qpos;
    if (this.terrain?.isAtEdge(x, y, EDGE)) {
      return this.putBack("The end of the field: put back to the start");
    }
    this.lying = this.isFallen || this.isRising ? this.lying + period : 0;
    this.steady = this.isStanding ? this.steady + period : 0;
    const patience = this.riser ? RISING : LYING;
    if (this.lying > patience) return this.putBack("It did not get up: put on its feet");
    if (this.riser && this.isFallen && !this.isRising) this.takeOver(this.riser);
    else if (this.isRising && this.steady > STEADY) this.takeOver(this.driver);
  }

  /**
   * Put the robot back to its start.
   * @param {string} reason
   */
  putBack(reason) {
    this.reset();
    this.onEvent(reason);
  }

  /** Free what MuJoCo holds. */
  delete() {
    this.data.delete();
    this.model.delete();
  }
}
